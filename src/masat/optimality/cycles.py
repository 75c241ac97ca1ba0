"""Winding numbers of ambiguous cycles, in which most local minima of a pose graph differ.

Along a cycle the measured rotations must add up to a multiple of 2 pi. From one local minimum to
the next, the edges of a cycle mostly share another 2 pi.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from typing import NamedTuple

import numpy as np

from masat import _core, lie, linear
from masat.arrays import Flags, Floats, Indices
from masat.graph import PoseGraph
from masat.information import rotation_weights
from masat.residuals import residuals

_TURN = 2 * np.pi
# An edge that keeps more than this fraction of a shift by 2 pi gains nothing from it.
_MAX_KEPT = 0.5
# chi2 that a shift must promise to gain from the rotations alone; positions always add to the cost.
_MIN_GAIN = 3.0
# Edges that take more than this fraction of what the cycle's own edge takes are of the same cycle.
_SAME_CYCLE = 0.5
# Weight of a rotation that is not measured, as a fraction of the median of those that are.
_NEGLIGIBLE = 1e-9
# Radians: nodes that rotate by less are fixed while a shift is tried.
_MIN_ROTATION = 0.2


class Cycle(NamedTuple):
    """The cycles through an edge, and how they share a shift by 2 pi.

    Attributes
    ----------
    edge : int
        Index of the edge.
    residual : float
        Angle of its rotation residual, in radians.
    axis : ndarray, () or (3,)
        Axis of that residual in the world; in 2D its sign.
    rotations : ndarray, (n,)
        By how much each node rotates for the least change of all rotations, in radians.
    """

    edge: int
    residual: float
    axis: Floats
    rotations: Floats


class AmbiguousCycles:
    """Finds the cycles of a graph that promise a lower chi2 when they are shifted by 2 pi.

    If rotations were all there is, a shift would cost 4 pi w (pi s - |e|): w is the weight of an
    edge of the cycle, e the angle of its residual, and s the fraction of the shift that it keeps
    while the rest of the cycle takes the remainder. Source: Carlone and Censi, From angular
    manifolds to the integer lattice, T-RO 2014, who search for all winding numbers at once and for
    rotations alone.

    Parameters
    ----------
    graph : PoseGraph
        The graph.
    unit : float
        The chi2 that counts as one.
    """

    def __init__(self, graph: PoseGraph, unit: float = 1.0) -> None:
        self._graph = graph
        self._min_gain = _MIN_GAIN * unit
        # chi2 is this weight times the square of the angle.
        self._weight = 2 * rotation_weights(graph.information)
        self._free = graph.elimination.free_nodes()
        self._free_index = np.full(len(graph.ids), -1, np.int32)
        self._free_index[self._free] = np.arange(len(self._free), dtype=np.int32)
        block = _without_zeros(self._weight)[:, None, None]
        zeros = np.zeros((len(graph.ids), 1, 1))
        self._problem = linear.LinearProblem(graph, linear.EdgeBlocks(block, -block, block), zeros)

    def rotations(self, edge: int) -> Floats:
        """Return by how much each node rotates for a shift by 2 pi at an edge, (n,), in radians."""
        i, j = self._graph.edge_indices[edge]
        linear_term = np.zeros((len(self._graph.ids), 1, 1))
        linear_term[j] = _TURN * self._weight[edge]
        linear_term[i] = -linear_term[j]
        return self._problem.solve(linear_term).ravel()

    @cached_property
    def _kept(self) -> Floats:
        """Return the fraction that each edge keeps of a shift of its own, (m,), from 0 to 1."""
        i, j = self._free_index[self._graph.edge_indices.T]
        every = np.arange(len(self._free), dtype=np.int32)
        own = np.append(self._problem.matrix.inverse(every, every).ravel(), 0.0)
        inside = (i >= 0) & (j >= 0)
        joint = np.zeros(len(i))
        joint[inside] = self._problem.matrix.inverse(i[inside], j[inside]).ravel()
        kept: Floats = 1 - self._weight * (own[i] + own[j] - 2 * joint)
        return kept

    def edges(self, poses: Floats) -> Indices:
        """Return the edges of the ambiguous cycles, the most promising first."""
        cost = self._cost(_rotation_residuals(self._graph, poses)[0])
        kept = self._kept
        found = np.flatnonzero((cost < -self._min_gain) & (kept < _MAX_KEPT) & (kept > 1e-9))
        order: Indices = found[np.argsort(cost[found], kind="stable")].astype(np.int32)
        return order

    def at(self, poses: Floats) -> Iterator[Cycle]:
        """Yield the ambiguous cycles, each once, by one of its edges, the most promising first."""
        i, j = self._graph.edge_indices.T
        residual, axis = _rotation_residuals(self._graph, poses)
        seen = np.zeros(len(residual), np.bool_)
        for edge in self.edges(poses):
            if seen[edge]:
                continue
            rotations = self.rotations(edge)
            taken = rotations[j] - rotations[i]
            taken[edge] -= _TURN
            seen |= np.abs(taken) > _SAME_CYCLE * abs(taken[edge])
            yield Cycle(int(edge), float(residual[edge]), axis[edge], rotations)

    def _cost(self, residual: Floats) -> Floats:
        cost: Floats = 2 * _TURN * self._weight * (np.pi * self._kept - residual)
        return cost


def _without_zeros(weights: Floats) -> Floats:
    """Return weights in which those of zero are negligible instead, so that the system is regular.

    Where no edge measures a rotation relative to the fixed nodes, the whole may rotate.
    """
    zero = weights == 0
    if not zero.any():
        return weights
    return np.where(
        zero, _NEGLIGIBLE * (np.median(weights[~zero]) if not zero.all() else 1), weights
    )


def _rotation_residuals(graph: PoseGraph, poses: Floats) -> tuple[Floats, Floats]:
    """Return the angles of the edges' rotation residuals, (m,), and their axes in the world."""
    d = graph.dimension
    e = residuals(graph, poses)[:, d:]
    if d == 2:
        return np.abs(e[:, 0]), np.where(e < 0, -1.0, 1.0)
    sine = np.sqrt(np.square(e).sum(axis=1))
    end = poses[graph.edge_indices[:, 1]]
    axis = _core.rotation_matrices(end) @ (e / np.maximum(sine, 1e-300)[:, None])[..., None]
    return 2 * np.arcsin(np.minimum(sine, 1.0)), axis[..., 0]


def rotated(poses: Floats, axis: Floats, angles: Floats) -> Floats:
    """Return poses rotated on the spot by angles about an axis of the world."""
    d = 2 if poses.shape[1] == 3 else 3
    steps = np.zeros((len(poses), lie.DOF[d]))
    if d == 2:
        steps[:, 2] = angles * axis
    else:
        own = axis @ _core.rotation_matrices(poses)
        half = (angles / 2 + np.pi / 2) % np.pi - np.pi / 2
        steps[:, 3:] = np.sin(half)[:, None] * own
    return lie.retract(poses, steps)


def relative_to_mean(angles: Floats, nodes: Flags) -> Floats:
    """Return the angles of some nodes less their mean, so that few nodes rotate; others get 0."""
    mean = np.exp(1j * angles[nodes]).mean()
    # A mean of nearly zero has no direction: rounding must not choose one.
    offset = np.angle(mean) if abs(mean) > 1e-9 else 0.0
    return np.where(nodes, angles - offset, 0.0)


def rotating_nodes(angles: Floats) -> Flags:
    """Return which nodes, (n,), the angles rotate away from where they are."""
    rotating: Flags = np.abs(angles - _TURN * np.round(angles / _TURN)) > _MIN_ROTATION
    return rotating
