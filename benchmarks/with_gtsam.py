"""gtsam's ways from a file to a map."""

from __future__ import annotations

import pathlib
from functools import partial
from typing import Any

import gtsam
import numpy as np

import masat
from benchmarks.paths import Clock, Path, Run, from_rotations, settled

_OPTIMIZERS = {
    "GN": (gtsam.GaussNewtonOptimizer, gtsam.GaussNewtonParams),
    "LM": (gtsam.LevenbergMarquardtOptimizer, gtsam.LevenbergMarquardtParams),
}


def paths(file: pathlib.Path, graph: masat.PoseGraph, folder: pathlib.Path) -> dict[str, Path]:
    """Return LAGO (2D) or the chordal start (3D) with each optimizer.

    LAGO takes no correlated noise: it gets a file of the information's diagonals, read beforehand.
    """
    if graph.dimension == 3:
        return {f"chordal + {o}": partial(_run, file, None, False, o) for o in _OPTIMIZERS}
    diagonal = folder / "diagonal.g2o"
    information = graph.information * np.eye(3)
    masat.write(
        masat.PoseGraph.from_arrays(
            graph.edges, graph.measurements, information, ids=graph.ids, poses=graph.poses
        ),
        diagonal,
    )
    uncorrelated = _read(diagonal, 2)[0]
    try:
        gtsam.lago.initialize(uncorrelated)
        chain = True
    except (RuntimeError, IndexError):  # the odometry has a gap: LAGO then finds a spanning tree
        chain = False
    return {f"LAGO + {o}": partial(_run, file, uncorrelated, chain, o) for o in _OPTIMIZERS}


def iteration(file: pathlib.Path, dimension: int, count: int) -> list[float]:
    """Return the times in ms of Gauss-Newton iterations from the poses of a file.

    By Cholesky; by QR where gtsam's Cholesky takes the system for singular (ais2klinik).
    """
    factors, values = _read(file, dimension)
    try:
        return _iterated(factors, values, "MULTIFRONTAL_CHOLESKY", count)
    except RuntimeError:
        return _iterated(factors, values, "MULTIFRONTAL_QR", count)


def _iterated(factors: Any, values: Any, linear_solver: str, count: int) -> list[float]:
    parameters = gtsam.GaussNewtonParams()
    parameters.setLinearSolverType(linear_solver)
    optimizer = gtsam.GaussNewtonOptimizer(factors, values, parameters)
    clock = Clock()
    times = []
    for _ in range(count):
        optimizer.iterate()
        times.append(clock.lap())
    return times[1:]


def _read(file: pathlib.Path, dimension: int) -> tuple[Any, Any]:
    """Return the factors of a file, its first node held, and its poses."""
    factors, values = gtsam.readG2o(str(file), dimension == 3)
    first = min(values.keys())
    noise = gtsam.noiseModel.Isotropic.Sigma(3 if dimension == 2 else 6, 1e-4)
    if dimension == 2:
        factors.add(gtsam.PriorFactorPose2(first, values.atPose2(first), noise))
    else:
        factors.add(gtsam.PriorFactorPose3(first, values.atPose3(first), noise))
    return factors, values


def _run(
    file: pathlib.Path, uncorrelated: Any, chain: bool, optimizer: str, iterations: int
) -> Run:
    dimension = 3 if uncorrelated is None else 2
    clock = Clock()
    factors, _ = _read(file, dimension)
    load = clock.lap()
    if uncorrelated is None:
        guess = gtsam.InitializePose3.initialize(factors)
    else:
        guess = gtsam.lago.initialize(uncorrelated, chain)
    started = clock.lap()
    make, parameters = _OPTIMIZERS[optimizer]
    solver = make(factors, guess, parameters())
    history = [solver.error()]
    while len(history) <= iterations:
        solver.iterate()
        history.append(solver.error())
        if settled(*history[-2:]):
            break
    took = clock.lap()
    return Run(load, started, took, history[1:], poses_of(solver.values(), dimension))


def poses_of(values: Any, dimension: int) -> masat.arrays.Floats:
    """Return gtsam's poses as masat has them, (n, 3) or (n, 7), in the order of the keys."""
    if dimension == 2:
        return np.asarray(gtsam.utilities.extractPose2(values), np.float64)
    rows = np.asarray(gtsam.utilities.extractPose3(values), np.float64)
    return from_rotations(rows[:, :9].reshape(-1, 3, 3), rows[:, 9:])
