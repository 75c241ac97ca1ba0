"""Whether `auto` ends at the lowest minimum known, and what it takes over Gauss-Newton.

Run `python -m benchmarks.minima` for the graphs in hard_minima (MASAT_DATA), or
`python -m benchmarks.minima FAMILY [FIRST [LAST]]` for fresh graphs with these seeds: a family of
`FAMILIES`, or a cell of the paper's evaluation such as Manhattan3500/.35,.35,.35, which needs the
paper's worlds (MASAT_DATASETS).
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Iterator
from time import perf_counter
from typing import NamedTuple

import numpy as np

import masat
from benchmarks.data import DATA
from masat.lie import between
from masat.residuals import residuals
from masat.worlds import WORLDS, perturb

SAME = 1e-6
# chi2 of graphs whose best map is not stored with them.
BEST = {"star10x100_0.1_0.2_1": 30.486929}
STARTS = ("chordal", "cauchy", "masat", "spanning_tree", "most_informed_first", "odometry")
METHODS = ("gauss_newton", "dogleg", "levenberg_marquardt")
TURNS = range(-3, 4)


class Row(NamedTuple):
    """A graph with what is known of it."""

    name: str
    graph: masat.PoseGraph
    best: float
    control_seconds: float


def cycle(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return poses that face along a closed line of points."""
    heading = np.arctan2(np.roll(y, -1) - y, np.roll(x, -1) - x)
    return np.column_stack([x, y, heading])


def world(poses: np.ndarray, edges: np.ndarray) -> masat.PoseGraph:
    """Return the graph of exact measurements between poses."""
    exact = between(poses[edges[:, 0]], poses[edges[:, 1]])
    return masat.PoseGraph.from_arrays(edges, exact, poses=poses)


def loop(nodes: int) -> masat.PoseGraph:
    """Return a circle of poses one meter apart."""
    angle = 2 * np.pi * np.arange(nodes) / nodes
    radius = nodes / (2 * np.pi)
    edges = np.column_stack([np.arange(nodes), (np.arange(nodes) + 1) % nodes])
    return world(cycle(radius * np.cos(angle), radius * np.sin(angle)), edges)


def corridor(nodes: int) -> masat.PoseGraph:
    """Return a straight line and back, two meters beside it."""
    half = nodes // 2
    there = np.arange(half)
    x = np.append(there, there[::-1])
    y = np.repeat([0.0, 2.0], half)
    edges = np.column_stack([np.arange(2 * half), (np.arange(2 * half) + 1) % (2 * half)])
    return world(cycle(x, y), edges)


def star(loops: int, length: int) -> masat.PoseGraph:
    """Return circles of poses that meet in node 0."""
    poses, edges = [np.zeros((1, 3))], []
    for k in range(loops):
        first = 1 + k * (length - 1)
        chain = np.concatenate([[0], first + np.arange(length - 1), [0]])
        edges.append(np.column_stack([chain[:-1], chain[1:]]))
        circle = loop(length).poses
        assert circle is not None
        poses.append(circle[1:] - [circle[0, 0], circle[0, 1], 0])
    return world(np.concatenate(poses), np.concatenate(edges))


def blobs(side: int, length: int, bridges: int) -> masat.PoseGraph:
    """Return two square grids of poses, joined by chains of poses."""
    random = np.random.default_rng(0)
    y, x = np.divmod(np.arange(side * side), side)
    grid = np.column_stack([x, y, random.uniform(-np.pi, np.pi, side * side)])
    index = np.arange(side * side).reshape(side, side)
    within = np.concatenate(
        [
            np.column_stack([a.ravel(), b.ravel()])
            for a, b in (
                (index[:, :-1], index[:, 1:]),
                (index[:-1], index[1:]),
                (index[:-1, :-1], index[1:, 1:]),
            )
        ]
    )
    other = grid + np.array([side + length, 0.0, 0.0])
    poses, edges = [grid, other], [within, within + side * side]
    free = 2 * side * side
    for k in range(bridges):
        row = side - 1 - k
        ends = row * side + side - 1, side * side + row * side
        inner = free + np.arange(length)
        free += length
        chain = np.concatenate([[ends[0]], inner, [ends[1]]])
        edges.append(np.column_stack([chain[:-1], chain[1:]]))
        along = side - 1 + (np.arange(length) + 1.0) * (length + 1) / (length + 1)
        poses.append(np.column_stack([along, np.full(length, row), np.zeros(length)]))
    return world(np.concatenate(poses), np.concatenate(edges))


def sparse(nodes: int) -> masat.PoseGraph:
    """Return a walk through Manhattan with few loop closures."""
    return WORLDS["manhattan"](nodes, round(1.1 * nodes), seed=1)


FAMILIES: dict[str, Callable[[int], masat.PoseGraph]] = {
    "loop": lambda seed: perturb(loop(300), (0.1, 0.1, 0.2), seed=seed),
    "corridor": lambda seed: perturb(corridor(1000), (0.1, 0.1, 0.1), seed=seed),
    "star": lambda seed: perturb(star(10, 100), (0.1, 0.1, 0.2), seed=seed),
    "blobs": lambda seed: perturb(
        blobs(15, (100, 200, 400)[seed % 3], 1 + seed % 5), (0.1, 0.1, 0.2), seed=seed
    ),
    "sparse": lambda seed: perturb(sparse(1500), (0.3, 0.3, 0.3), seed=seed),
    "sphere": lambda seed: perturb(WORLDS["sphere"](500, seed=seed), (0.5, 0.5), seed=seed),
    "torus": lambda seed: perturb(WORLDS["torus"](1000, seed=seed), (0.4, 0.5), seed=seed),
}


def wound(graph: masat.PoseGraph) -> Iterator[masat.PoseGraph]:
    """Yield starts of a single cycle: its odometry, closed with other winding numbers."""
    poses = masat.initialize(graph, "odometry").poses
    assert poses is not None
    bend = residuals(graph, poses)[-1, 2]
    for turns in TURNS:
        angles = -(bend + 2 * np.pi * turns) * np.arange(len(poses)) / len(poses)
        out = poses.copy()
        out[:, 2] += angles
        moves = graph.measurements[: len(poses) - 1, :2]
        cos, sin = np.cos(out[:-1, 2]), np.sin(out[:-1, 2])
        out[1:, 0] = np.cumsum(cos * moves[:, 0] - sin * moves[:, 1])
        out[1:, 1] = np.cumsum(sin * moves[:, 0] + cos * moves[:, 1])
        yield graph.with_poses(out)


def lowest(graph: masat.PoseGraph, truth: masat.PoseGraph | None) -> float:
    """Return the lowest chi2 that all starts and methods reach."""
    starts = [masat.initialize(graph, name) for name in STARTS]
    if truth is not None:
        starts.append(truth)
    if graph.dimension == 2 and len(graph.edges) == len(graph.ids):
        starts += wound(graph)
    return min(masat.optimize(start, method).chi2 for start in starts for method in METHODS)


def hard() -> Iterator[Row]:
    """Yield the graphs of hard_minima."""
    for path in sorted((DATA / "hard_minima").glob("*.g2o.gz")):
        name = path.name.removesuffix(".g2o.gz")
        if name.endswith("_best"):
            continue
        graph = masat.read(path)
        best, seconds = BEST.get(name, np.inf), np.nan
        stored = path.with_name(f"{name}_best.g2o.gz")
        if stored.exists():
            begin = perf_counter()
            known = masat.read(stored).poses
            assert known is not None
            control = masat.optimize(graph.with_poses(known), "gauss_newton")
            best, seconds = control.chi2, perf_counter() - begin
        yield Row(name, graph, best, seconds)


def fresh(family: str, seeds: range) -> Iterator[Row]:
    """Yield graphs of a family or a cell, with the lowest chi2 of all starts."""
    for seed in seeds:
        if "/" in family:
            from masat.study.names import Case
            from masat.study.trial import instance

            name, sigma = family.split("/")
            graph = instance(Case(name, tuple(map(float, sigma.split(","))), seed))
        else:
            graph = FAMILIES[family](seed)
        begin = perf_counter()
        control = masat.optimize(graph, "gauss_newton")
        seconds = perf_counter() - begin
        best = min(control.chi2, np.inf if "/" in family else lowest(graph, graph))
        yield Row(f"{family} {seed}", graph, best, seconds)


def main() -> None:
    """Print a table."""
    warnings.simplefilter("ignore")
    rows = hard()
    if len(sys.argv) > 1:
        numbers = [int(a) for a in sys.argv[2:]] or [0, 10]
        rows = fresh(sys.argv[1], range(numbers[0], numbers[-1] + (len(numbers) == 1)))
    print(f"{'graph':<36}{'nodes':>7}{'best':>15}{'auto':>15}{'above':>10}{'s':>8}{'control':>9}")
    above, ratios, count = 0, [], 0
    for name, graph, best, seconds in rows:
        begin = perf_counter()
        chi2 = masat.solve(graph).chi2
        taken = perf_counter() - begin
        count, above = count + 1, above + (chi2 > best * (1 + SAME))
        ratios.append(taken / seconds)
        line = f"{name:<36}{len(graph.ids):>7}{best:>15.6f}{chi2:>15.6f}{chi2 / best - 1:>10.1e}"
        print(f"{line}{taken:>8.2f}{taken / seconds:>9.1f}", flush=True)
    print(f"{above} of {count} above the best; median time {np.nanmedian(ratios):.1f} controls")


if __name__ == "__main__":
    main()
