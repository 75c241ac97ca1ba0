"""Winding numbers of ambiguous cycles, in which most local minima of a pose graph differ.

Along a cycle the measured rotations must add up to a multiple of 2 pi. From one local minimum to
the next, the edges of a cycle mostly share another 2 pi.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
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
# Edges that take more than this fraction of what the cycle's own edge takes are of the same cycle.
_SAME_CYCLE = 0.9
# Edges that take more than this fraction bend with the cycle.
_SHARING = 0.1
# Correlation of the shifts of two cycles from which on they are tried together.
_OVERLAP = 0.1
# Edges from which on a cycle can bend in several ways without another winding number, and how
# many of them are cut, one at a time.
LONG, _CUTS = 50, 4
# Cost of a shift, by the rotations alone, up to which a long cycle is ambiguous: together with
# other cycles, or with the positions, the shift may pay.
_LONG_COST = 20.0
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
    cost : float
        By how much the shift against the residual changes chi2, if rotations are all there is.
    stiffness : float
        The same where all residuals are zero.
    edges : ndarray, (k,)
        Indices of the edges that share the shift alike, in ascending order.
    nodes : ndarray of bool, (n,)
        The ends of all edges that take a good part of the shift.
    """

    edge: int
    residual: float
    axis: Floats
    rotations: Floats
    cost: float
    stiffness: float
    edges: Indices
    nodes: Flags


class AmbiguousCycles:
    """Finds the cycles of a graph that promise a lower chi2 when they are shifted by 2 pi.

    If rotations were all there is, a shift would cost 4 pi w (pi s - |e|): w is the weight of an
    edge of the cycle, e the angle of its residual, and s the fraction of the shift that it keeps
    while the rest of the cycle takes the remainder. Positions always add to that cost. Source:
    Carlone and Censi, From angular manifolds to the integer lattice, T-RO 2014, who search for all
    winding numbers at once and for rotations alone.

    Parameters
    ----------
    graph : PoseGraph
        The graph.
    """

    def __init__(self, graph: PoseGraph) -> None:
        self._graph = graph
        self._weight = rotation_weight(graph)
        self._free = graph.elimination.free_nodes()
        self._free_index = np.full(len(graph.ids), -1, np.int32)
        self._free_index[self._free] = np.arange(len(self._free), dtype=np.int32)
        self._problem = rotation_problem(graph, self._weight)

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
        cost = self._cost(rotation_residuals(self._graph, poses)[0])
        kept = self._kept
        limit = np.where(kept * LONG < 1, _LONG_COST, 0.0)
        found = np.flatnonzero((cost < limit) & (kept < _MAX_KEPT) & (kept > 1e-9))
        order: Indices = found[np.argsort(cost[found], kind="stable")].astype(np.int32)
        return order

    def at(self, poses: Floats) -> Iterator[Cycle]:
        """Yield the ambiguous cycles, each once, by one of its edges, the most promising first."""
        i, j = self._graph.edge_indices.T
        residual, axis = rotation_residuals(self._graph, poses)
        cost = self._cost(residual)
        seen = np.zeros(len(residual), np.bool_)
        for edge in self.edges(poses):
            if seen[edge]:
                continue
            rotations = self.rotations(edge)
            taken = rotations[j] - rotations[i]
            taken[edge] -= _TURN
            own = np.abs(taken) > _SAME_CYCLE * abs(taken[edge])
            seen |= own
            nodes = np.zeros(len(rotations), np.bool_)
            nodes[self._graph.edge_indices[np.abs(taken) > _SHARING * abs(taken[edge])]] = True
            yield Cycle(
                int(edge),
                float(residual[edge]),
                axis[edge],
                rotations,
                float(cost[edge]),
                self._stiffness(edge),
                np.flatnonzero(own).astype(np.int32),
                nodes,
            )

    def pairs(self, cycles: Sequence[Cycle]) -> list[tuple[Cycle, Cycle]]:
        """Return pairs that share edges, both long or of a promising cost, the best first."""
        i, j = self._graph.edge_indices.T
        found = []
        for k, one in enumerate(cycles):
            for other in cycles[:k]:
                edge = other.edge
                taken = one.rotations[i[edge]] - one.rotations[j[edge]]
                # Half of what the two shifts add to the sum of their costs.
                joint = _TURN * self._weight[edge] * taken * float(np.dot(one.axis, other.axis))
                own = one.stiffness * other.stiffness
                cost = one.cost + other.cost + 2 * joint
                long = len(one.edges) >= LONG and len(other.edges) >= LONG
                if (cost < 0 or long) and abs(joint) > _OVERLAP * own**0.5:
                    found.append((cost, other, one))
        found.sort(key=lambda pair: pair[0])
        return [(one, other) for _, one, other in found]

    def _stiffness(self, edge: int) -> float:
        """Return what a shift by 2 pi at an edge costs where all residuals are zero."""
        return float(_TURN**2 * self._weight[edge] * self._kept[edge])

    def _cost(self, residual: Floats) -> Floats:
        cost: Floats = 2 * _TURN * self._weight * (np.pi * self._kept - residual)
        return cost


def shifted(graph: PoseGraph, shifts: Floats) -> Floats:
    """Return poses in which rotation residuals, and shifts of them, are spread anew.

    The rotations are those that minimize the weighted squares of all rotation residuals and
    shifts, in 2D exactly, in 3D to first order; positions stay.

    Parameters
    ----------
    graph : PoseGraph
        A graph with poses.
    shifts : ndarray, (m, 1) or (m, 3)
        What is added to the residual of each edge: an angle, or a rotation vector in the world.

    Returns
    -------
    ndarray, (n, 3) or (n, 7)
    """
    assert graph.poses is not None
    angles, axes = rotation_residuals(graph, graph.poses)
    weight = rotation_weight(graph)
    slope = weight[:, None] * (angles[:, None] * axes.reshape(len(angles), -1) + shifts)
    i, j = graph.edge_indices.T
    term = np.zeros((len(graph.ids), 1, slope.shape[1]))
    np.subtract.at(term[:, 0], j, slope)
    np.add.at(term[:, 0], i, slope)
    return rotated(graph.poses, rotation_problem(graph, weight, slope.shape[1]).solve(term)[:, 0])


def cut_edges(cycle: Cycle) -> Indices:
    """Return a few edges of a long cycle, evenly spaced, and none of a short one."""
    count = len(cycle.edges)
    if count < LONG:
        return cycle.edges[:0]
    chosen: Indices = cycle.edges[np.linspace(0, count - 1, _CUTS).astype(np.int64)]
    return chosen


def rotation_weight(graph: PoseGraph) -> Floats:
    """Return the weights, (m,), by which the squares of the edges' angles add up to chi2."""
    weight: Floats = 2 * rotation_weights(graph.information)
    return weight


def rotation_problem(graph: PoseGraph, weight: Floats, columns: int = 1) -> linear.LinearProblem:
    """Return the problem of the nodes' rotations from weights of edges, as if all were angles."""
    block = _without_zeros(weight)[:, None, None]
    blocks = linear.EdgeBlocks(block, -block, block)
    return linear.LinearProblem(graph, blocks, np.zeros((len(graph.ids), 1, columns)))


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


def rotation_residuals(graph: PoseGraph, poses: Floats) -> tuple[Floats, Floats]:
    """Return the angles of the edges' rotation residuals, (m,), and their axes in the world."""
    d = graph.dimension
    e = residuals(graph, poses)[:, d:]
    if d == 2:
        return np.abs(e[:, 0]), np.where(e < 0, -1.0, 1.0)
    sine = np.sqrt(np.square(e).sum(axis=1))
    end = poses[graph.edge_indices[:, 1]]
    axis = _core.rotation_matrices(end) @ (e / np.maximum(sine, 1e-300)[:, None])[..., None]
    return 2 * np.arcsin(np.minimum(sine, 1.0)), axis[..., 0]


def rotated(poses: Floats, vectors: Floats) -> Floats:
    """Return poses rotated on the spot by angles, (n, 1), or rotation vectors of the world."""
    d = 2 if poses.shape[1] == 3 else 3
    steps = np.zeros((len(poses), lie.DOF[d]))
    if d == 2:
        steps[:, 2] = vectors[:, 0]
    else:
        angles = np.sqrt(np.square(vectors).sum(axis=1))
        axes = vectors / np.maximum(angles, 1e-300)[:, None]
        own = (axes[:, None] @ _core.rotation_matrices(poses))[:, 0]
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
