"""Graphs with false loop closures: what the robust solve is measured on, and what is wanted."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache, partial
from statistics import median
from time import perf_counter

import masat
from benchmarks.data import DATA
from benchmarks.graphs import quietly_read
from masat import PoseGraph
from masat.chain import odometry_edges
from masat.study.closure_trial import Spoiled, unsolved
from masat.study.names import number_name
from masat.worlds import add_false_closures, grid, normalized, perturb

_FILES = {
    "CSAIL": "2d/CSAIL.g2o",
    "intel": "2d/intel.g2o",
    "M3500": "2d/input_M3500_g2o.g2o",
    "ring": "2d/ring.g2o",
    "kitti_00": "2d/kitti_00.g2o",
    "MIT": "2d/MIT.g2o",
    "city10000": "2d/city10000.g2o",
    "sphere2500": "3d/sphere2500.g2o",
    "torus3D": "3d/torus3D.g2o.gz",
    "garage": "3d/parking-garage.g2o",
}
# Nodes of the public graph of which the first ones are taken.
_FIRST_NODES = {"garage": 400}
_GRID_NODES, _GRID_SIGMA = 125, (0.05, 0.05)
_PLAIN_SOLVES = 3

ALL_KINDS = ("random", "local", "grouped", "alias")
# Those of the simulated grid and the garage.
_KINDS_3D = ("random", "grouped", "alias")


@dataclass(frozen=True)
class Row:
    """A row of the table: one graph with one kind and fraction of false loop closures.

    Attributes
    ----------
    graph, kind, fraction
        As `clean_graph` and `masat.worlds.add_false_closures` take them.
    factor : float
        By which the information of all loop closures is multiplied, the true ones included.
    success, strict, recall : float
        Wanted: fractions of the seeds with success and with strict success, and the mean recall.
    only_true : bool
        Whether no false loop closure may be kept.
    """

    graph: str
    kind: str
    fraction: float
    factor: float = 1.0
    success: float = 0.0
    strict: float = 0.0
    recall: float = 0.0
    only_true: bool = False

    @property
    def name(self) -> str:
        """The name of the row, such as 'spoiled M3500 alias .5'."""
        table = "spoiled" if self.factor == 1 else "scales"
        factor = "" if self.factor == 1 else f" x{self.factor:g}"
        return f"{table} {self.graph} {self.kind} {number_name(self.fraction)}{factor}"


def _rows() -> Iterator[Row]:
    for graph in ("CSAIL", "intel"):
        for kind in ALL_KINDS:
            for fraction in (0.1, 0.25, 0.5, 0.75, 0.9):
                yield Row(graph, kind, fraction, success=1.0)
    for kind, fraction in (("random", 0.5), ("alias", 0.25), ("alias", 0.5)):
        yield Row("M3500", kind, fraction, strict=0.9, recall=0.995)
    for graph in ("ring", "kitti_00"):
        for kind in ("random", "alias"):
            yield Row(graph, kind, 0.5, success=0.9)
    for graph in ("grid", "garage"):
        for kind in _KINDS_3D:
            for fraction in (0.5, 0.9):
                yield Row(graph, kind, fraction, success=0.9)
    for graph in ("sphere2500", "torus3D"):
        for kind in ("grouped", "alias"):
            yield Row(graph, kind, 0.5, success=0.9)
    for kind in ("random", "alias"):
        yield Row("city10000", kind, 0.5, success=0.9)
    yield Row("MIT", "random", 0.5, success=0.5)
    for graph in ("M3500", "CSAIL"):
        for factor in (25, 4, 1 / 50):
            yield Row(graph, "alias", 0.25, factor, recall=0.95, only_true=True)


ROWS: dict[str, Row] = {row.name: row for row in _rows()}


def spoiled_graphs(row: Row, seeds: int) -> Iterator[Spoiled]:
    """Yield the graphs of a row, seed by seed."""
    for seed in range(seeds):
        clean, plain_seconds = clean_graph(row.graph, seed)
        graph, is_false = add_false_closures(clean, row.kind, row.fraction, seed=seed)
        if row.factor != 1:
            information = graph.information.copy()
            information[~odometry_edges(graph)] *= row.factor
            graph = replace(graph, information=information)
        yield Spoiled(clean, unsolved(graph), is_false, plain_seconds)


def clean_graph(name: str, seed: int) -> tuple[PoseGraph, float]:
    """Return a graph at its optimum, its information normalized, and the time of a plain solve.

    The graphs are those of `_FILES` and "grid": simulated with the noise of the seed.
    """
    if name == "grid":
        return _solved(perturb(grid(_GRID_NODES), _GRID_SIGMA, seed=seed))
    return _clean_file(name)


@cache
def _clean_file(name: str) -> tuple[PoseGraph, float]:
    graph = quietly_read(DATA / _FILES[name])
    return _solved(graph.without_nodes(graph.ids[_FIRST_NODES.get(name, len(graph)) :].tolist()))


def _solved(graph: PoseGraph) -> tuple[PoseGraph, float]:
    result, seconds = plainly_solved(graph)
    return normalized(result.graph), seconds


def plainly_solved(graph: PoseGraph) -> tuple[masat.Result, float]:
    """Return the result of a plain solve, and its median time."""
    result, times = masat.solve(unsolved(graph)), []
    for _ in range(_PLAIN_SOLVES):
        _, seconds = timed(partial(masat.solve, unsolved(graph)))
        times.append(seconds)
    return result, median(times)


def timed(task: Callable[[], masat.Result]) -> tuple[masat.Result, float]:
    """Return what a task returns, and its time in seconds."""
    begin = perf_counter()
    found = task()
    return found, perf_counter() - begin
