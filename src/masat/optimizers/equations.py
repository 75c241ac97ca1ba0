"""A graph's normal equations, and what can be said of them before and after a failure."""

from __future__ import annotations

import os
from typing import Protocol

import numpy as np

from masat import _core
from masat.arrays import Floats, Indices
from masat.errors import OptimizationError
from masat.graph import PoseGraph

_EPSILON = float(np.finfo(np.float64).eps)
# Operations of one factorization above which a second thread pays for an iteration, and the most
# threads that do: the top of the elimination tree does not occupy more.
_MIN_PARALLEL_OPERATIONS, _MAX_THREADS = 3e7, 8
_MAX_GIVEN_THREADS = 1024


class Equations(Protocol):
    """What an optimizer sees of a cost: its value, and a quadratic model of it.

    That of `_core.NormalEquations` is chi2.
    """

    def chi2(self, poses: Floats, /) -> float:
        """Return the cost."""

    def linearize(self, poses: Floats, /) -> float:
        """Set H and `rhs`, the gradient's negative half; return the cost."""

    def rhs(self) -> Floats:
        """Return the gradient's negative half."""

    def diagonal(self) -> Floats:
        """Return the diagonal of H."""

    def multiply(self, v: Floats, /) -> Floats:
        """Return H v."""

    def factorize(self, damping: Floats, /) -> int:
        """Factorize H plus a diagonal; return -1, or the node where it is not definite."""

    def solve(self) -> Floats:
        """Return the step: what was factorized times it is `rhs`."""

    def retract(self, poses: Floats, step: Floats, /) -> Floats:
        """Return the poses after a step."""


def normal_equations(graph: PoseGraph, threads: int | None = None) -> _core.NormalEquations:
    """Lay out the system of the free nodes of a graph."""
    return _core.NormalEquations(
        graph.topology,
        graph.elimination,
        graph.measurements,
        graph.information,
        threads_of(threads, graph.elimination.operations(graph.dof)),
        graph.sensor_offsets,
        graph.range_bearing_edges,
    )


def threads_of(given: int | None, operations: float) -> int:
    """Return the threads that were asked for, or else as many as pay on this machine.

    All parts of an iteration use as many; `operations` are those of its factorization.
    """
    if given is not None:
        return checked_threads(given)
    if operations < _MIN_PARALLEL_OPERATIONS:
        return 1
    return max(1, min(_MAX_THREADS, _available_cores()))


def checked_threads(threads: int) -> int:
    """Return a number of threads that was asked for, if there can be as many."""
    if not 1 <= threads <= _MAX_GIVEN_THREADS:
        raise OptimizationError(f"threads must be from 1 to {_MAX_GIVEN_THREADS}, got {threads}")
    return threads


def _available_cores() -> int:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class BestSoFar:
    """Equations that remember the poses of the lowest cost that they were asked about.

    `latest` are the poses that they were asked about last: when an optimizer reports an iteration,
    those after it.
    """

    def __init__(self, inner: Equations, poses: Floats, chi2: float) -> None:
        self._inner = inner
        self.poses, self.lowest = poses, chi2
        self.latest = poses
        self.rhs, self.diagonal, self.multiply = inner.rhs, inner.diagonal, inner.multiply
        self.factorize, self.solve, self.retract = inner.factorize, inner.solve, inner.retract

    def chi2(self, poses: Floats, /) -> float:
        """Return the cost, and remember poses of a lower one."""
        return self._remembered(poses, self._inner.chi2(poses))

    def linearize(self, poses: Floats, /) -> float:
        """Linearize, and remember poses of a lower cost."""
        return self._remembered(poses, self._inner.linearize(poses))

    def _remembered(self, poses: Floats, chi2: float) -> float:
        self.latest = poses
        if chi2 < self.lowest:
            self.poses, self.lowest = poses, chi2
        return chi2


def rounding_level(graph: PoseGraph) -> float:
    """Return the chi2 that the rounding of coordinates alone makes."""
    if graph.poses is None:
        return 0.0
    return rounding_of(graph.poses, graph.edge_indices, graph.information)


def rounding_of(poses: Floats, edges: Indices, information: Floats) -> float:
    """Return the chi2 that the rounding of coordinates alone makes.

    The coordinates of an edge are known to half a unit in the last place of the largest one of its
    two nodes; an angle to that of 1.
    """
    if len(edges) == 0:
        return 0.0
    d = 2 if poses.shape[1] == 3 else 3
    largest = np.maximum(np.abs(poses[:, :d]).max(axis=1), 1.0)
    reach = np.maximum(largest[edges[:, 0]], largest[edges[:, 1]])
    # Column by column: sums along short axes take many times as long.
    diagonal = [information[:, k, k] for k in range(information.shape[1])]
    moved = np.square(reach) @ sum(diagonal[1:d], diagonal[0])
    return float(_EPSILON**2 * (moved + sum(turn.sum() for turn in diagonal[d:])))


def why_singular(graph: PoseGraph, node: int) -> str:
    """Say which node a singular system does not determine, and what its edges measure."""
    touching = (graph.edge_indices == node).any(axis=1)
    spectrum = np.linalg.eigvalsh(graph.information[touching])
    component = int(np.count_nonzero(graph.components == graph.components[node]))
    return (
        f"the edges around node {graph.ids[node]} (component of {component} nodes) do not "
        f"determine its pose: information from {spectrum.min():.3g} to {spectrum.max():.3g} on "
        f"its {np.count_nonzero(touching)} edges; if a rotation residual is half a turn, take "
        "another initial guess; else use Levenberg-Marquardt"
    )
