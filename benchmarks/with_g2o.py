"""g2o-python's ways from a file to a map.

The wheel knows no tags, so `SparseOptimizer.load` finds nothing in any file: its objects are made
in Python from what masat read, and the time of that is its `load`. Its linear solvers are Eigen's.
"""

from __future__ import annotations

import pathlib
from collections.abc import Callable
from functools import partial
from typing import Any

import g2o
import numpy as np

import masat
from benchmarks.graphs import quietly_read
from benchmarks.paths import Clock, Path, Run, from_rotations
from masat.arrays import Floats

_OPTIMIZERS = {
    "GN": g2o.OptimizationAlgorithmGaussNewton,
    "LM": g2o.OptimizationAlgorithmLevenberg,
}
_TYPES = {
    2: (g2o.VertexSE2, g2o.EdgeSE2, g2o.BlockSolverSE2, g2o.LinearSolverEigenSE2),
    3: (g2o.VertexSE3, g2o.EdgeSE3, g2o.BlockSolverSE3, g2o.LinearSolverEigenSE3),
}


def paths(file: pathlib.Path) -> dict[str, Path]:
    """Return the spanning tree with each optimizer."""
    graph = quietly_read(file)
    return {f"spanning tree + {o}": partial(_run, graph, o, True) for o in _OPTIMIZERS}


def path_from(graph: masat.PoseGraph) -> Path:
    """Return Gauss-Newton from the poses of a graph."""
    return partial(_run, graph, "GN", False)


def iteration(graph: masat.PoseGraph, count: int) -> list[float]:
    """Return the times in ms of Gauss-Newton iterations from the poses of a graph."""
    return [1e3 * one.time_iteration for one in _measured(built(graph, "GN"), count)][1:]


def built(graph: masat.PoseGraph, optimizer: str) -> Any:
    """Return g2o's optimizer with a graph in it, its first node fixed."""
    vertex, edge, block_solver, linear_solver = _TYPES[graph.dimension]
    pose = _planar if graph.dimension == 2 else _spatial
    linear = linear_solver()
    linear.set_block_ordering(True)
    whole = g2o.SparseOptimizer()
    whole.set_algorithm(_OPTIMIZERS[optimizer](block_solver(linear)))
    poses = graph.poses
    if poses is None:
        poses = masat.initialize(graph, "masat").poses
        assert poses is not None
    vertices = []
    for index, value in enumerate(poses):
        one = vertex()
        one.set_id(index)
        one.set_estimate(pose(value))
        whole.add_vertex(one)
        vertices.append(one)
    vertices[0].set_fixed(True)
    for (a, b), z, w in zip(
        graph.edge_indices.tolist(), graph.measurements, graph.information, strict=True
    ):
        one = edge()
        one.set_vertex(0, vertices[a])
        one.set_vertex(1, vertices[b])
        one.set_measurement(pose(z))
        one.set_information(w)
        whole.add_edge(one)
    return whole


def _planar(pose: Floats) -> Any:
    return g2o.SE2(pose)


def _spatial(pose: Floats) -> Any:
    return g2o.Isometry3d(g2o.Quaternion(pose[6], pose[3], pose[4], pose[5]), pose[:3])


def _measured(whole: Any, iterations: int) -> list[Any]:
    """Optimize; return the statistics of each iteration."""
    whole.initialize_optimization()
    whole.set_compute_batch_statistics(True)
    done = whole.optimize(iterations)
    return list(whole.batch_statistics()[: max(0, done)])


def _run(graph: masat.PoseGraph, optimizer: str, tree: bool, iterations: int) -> Run:
    clock = Clock()
    whole = built(graph, optimizer)
    # Stops where another iteration would gain little; it has to be kept alive.
    enough = g2o.SparseOptimizerTerminateAction()
    enough.set_gain_threshold(1e-8)
    whole.add_post_iteration_action(enough)
    load = clock.lap()
    whole.initialize_optimization()
    if tree:
        whole.compute_initial_guess()
    started = clock.lap()
    history = [one.chi2 for one in _measured(whole, iterations)]
    took = clock.lap()
    whole.remove_post_iteration_action(enough)
    return Run(load, started, took, history, _poses(whole, graph))


def _poses(whole: Any, graph: masat.PoseGraph) -> Floats:
    take: Callable[[Any], Floats] = (
        (lambda e: e.to_vector()) if graph.dimension == 2 else (lambda e: e.matrix()[:3])
    )
    rows = np.array([take(whole.vertex(k).estimate()) for k in range(len(graph.ids))])
    return rows if graph.dimension == 2 else from_rotations(rows[:, :, :3], rows[:, :, 3])
