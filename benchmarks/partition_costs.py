"""What cities of up to 10^8 poses cost on up to 1,000 workers, from their assembly trees.

    python -m benchmarks.partition_costs [--poses N ..] [--workers N ..] [--beyond N ..]

Each city is cut into two parts a worker, and at least eight; nothing is solved. Cities that are too
large to be made here are extrapolated from the two largest that are: operations as a n + b n^1.5,
memory as a n + b n log n (George, Nested dissection of a regular finite element mesh, SIAM Journal
on Numerical Analysis 1973), bytes sent as a n^b.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

import masat
from masat.parts.cost import Cost, cost
from masat.worlds import city


def costs_of(poses: int, workers: list[int]) -> list[Cost]:
    """Return what an iteration costs on each number of workers."""
    graph = city(poses)
    found = []
    for count in workers:
        with tempfile.TemporaryDirectory() as folder:
            made = masat.partition(graph, Path(folder) / "parts", max(8, 2 * count))
            found.append(cost(made.index, count))
    return found


def through(
    sizes: tuple[int, int], values: tuple[float, float], terms: Callable[[float], list[float]]
) -> Callable[[float], float]:
    """Return the sum of two terms of a size that has these values, without negative factors."""
    matrix = np.array([terms(n) for n in sizes])
    factors = np.linalg.solve(matrix, values)
    if factors.min() < 0:
        # One term alone, the one that grows faster: through the larger city.
        factors = np.array([0.0, values[1] / matrix[1, 1]])
    return lambda n: float(np.dot(terms(n), factors))


def power(sizes: tuple[int, int], values: tuple[float, float]) -> Callable[[float], float]:
    """Return the power of a size that has these values."""
    if min(values) <= 0:
        return lambda n: 0.0
    exponent = np.log(values[1] / values[0]) / np.log(sizes[1] / sizes[0])
    return lambda n: float(values[1] * (n / sizes[1]) ** exponent)


def extrapolated(sizes: tuple[int, int], costs: tuple[Cost, Cost], poses: int) -> Cost:
    """Return what a larger city costs on the same number of workers."""

    def operations(n: float) -> list[float]:
        return [n, n**1.5]

    def memory(n: float) -> list[float]:
        return [n, n * np.log(n)]

    one, other = costs
    return Cost(
        one.workers,
        through(sizes, (one.operations, other.operations), operations)(poses),
        through(sizes, (one.critical, other.critical), operations)(poses),
        round(through(sizes, (one.memory, other.memory), memory)(poses)),
        round(power(sizes, (one.sent, other.sent))(poses)),
    )


def row(poses: int, found: Cost, mark: str = " ") -> str:
    """Return a row of the table."""
    return (
        f"{mark}{poses:>12,}{found.workers:>9}{found.operations:>13.2e}{found.critical:>13.2e}"
        f"{found.speedup:>9.1f}{found.memory / 1e9:>12.2f}{found.sent / 1e9:>10.3f}"
    )


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__, allow_abbrev=False)
    parser.add_argument("--poses", type=int, nargs="+", default=[100_000, 1_000_000])
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 10, 100, 1000])
    parser.add_argument("--beyond", type=int, nargs="+", default=[10_000_000, 100_000_000])
    options = parser.parse_args()
    print("an iteration; ~ is extrapolated; memory is that of the largest worker's systems")
    print(
        f"{'poses':>13}{'workers':>9}{'operations':>13}{'critical':>13}{'speedup':>9}"
        f"{'GB a worker':>12}{'GB sent':>10}"
    )
    sizes = sorted(options.poses)
    found = {}
    for poses in sizes:
        found[poses] = costs_of(poses, options.workers)
        for one in found[poses]:
            print(row(poses, one), flush=True)
    for poses in options.beyond if len(sizes) > 1 else []:
        for pair in zip(*(found[n] for n in sizes[-2:]), strict=True):
            print(row(poses, extrapolated((sizes[-2], sizes[-1]), pair, poses), "~"), flush=True)


if __name__ == "__main__":
    main()
