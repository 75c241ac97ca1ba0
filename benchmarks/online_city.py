"""A city of many poses as a stream, and edges that are removed and come back.

    python -m benchmarks.online_city [--poses N] [--removed N]

Prints the time of a step, the memory of the factor over that of the batch factor, and the excess of
chi2 over the optimum as the map grows: none of them may drift. Then loop closures of city10000 are
removed one by one, an update after each, and added again.
"""

from __future__ import annotations

import argparse
from time import thread_time

import numpy as np

import masat
from benchmarks.graphs import CASES, quietly_read
from benchmarks.threads import single_threaded
from masat import lie, worlds
from masat.online.stream import steps

_ROWS = 10


def grow(graph: masat.PoseGraph) -> None:
    """Print ten rows while a map grows."""
    world, times = masat.OnlineMap(graph.dimension), []
    every = len(graph) // _ROWS
    print(
        f"{'poses':>8}{'edges':>9}{'median ms':>11}{'p99':>8}{'max':>8}{'memory':>8}{'excess':>9}"
    )
    for k, step in enumerate(steps(graph)):
        begin = thread_time()
        world.add_pose(step.node)
        rows = step.edges
        if len(rows):
            world.add_edges(graph.edges[rows], graph.measurements[rows], graph.information[rows])
        world.update()
        times.append(1e3 * (thread_time() - begin))
        if (k + 1) % every:
            continue
        own = world.graph()
        best = masat.optimize(own, relative_tolerance=1e-11)
        memory = world._core.bytes_of_factor() / 8 / own.elimination.fill(own.dof)
        row = np.array(times)
        print(
            f"{k + 1:>8}{len(own.edges):>9}{np.median(row):>11.3f}{np.percentile(row, 99):>8.2f}"
            f"{row.max():>8.1f}{memory:>8.2f}{own.chi2 / best.chi2 - 1:>9.1e}",
            flush=True,
        )
        times.clear()


def remove(count: int) -> None:
    """Print how far the map is from what it was when removed edges have come back."""
    graph = quietly_read(CASES["city10000"].source)
    world = masat.OnlineMap(graph.dimension, tolerance=0)
    for node in graph.ids.tolist():
        world.add_pose(node)
    numbers = world.add_edges(graph.edges, graph.measurements, graph.information)
    world.update()
    world.optimize()
    before, chi2 = world.poses, world.chi2
    apart = np.flatnonzero(np.abs(np.diff(graph.edge_indices, axis=1))[:, 0] > 1)
    chosen = np.random.default_rng(0).choice(apart, count, replace=False)
    for k in chosen:
        world.remove_edges(int(numbers[k]))
        world.update()
    for k in chosen:
        world.add_edges(graph.edges[k], graph.measurements[k], graph.information[k])
        world.update()

    def print_difference(what: str) -> None:
        moved = np.abs(lie.local(before, world.poses)).max()
        change = abs(world.chi2 / chi2 - 1)
        print(f"{what}: poses differ by {moved:.1e}, chi2 by {change:.1e}", flush=True)

    print_difference(f"{count} edges removed and added")
    world.optimize()
    print_difference("after optimize()")


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__, allow_abbrev=False)
    parser.add_argument("--poses", type=int, default=100_000)
    parser.add_argument("--removed", type=int, default=1000)
    options = parser.parse_args()
    single_threaded()
    if options.removed:
        remove(options.removed)
    if options.poses:
        world = worlds.city(options.poses, seed=0)
        grow(worlds.perturb(world, (0.05, 0.05, 0.02), seed=0))


if __name__ == "__main__":
    main()
