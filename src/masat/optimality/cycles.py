"""Whole turns around weak loops: what most local minima of a pose graph differ in.

Along a loop the measured rotations must add up to whole turns, and how many these are tells most
minima apart: from one to the next, the edges of a loop share another 2 pi.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from typing import NamedTuple

import numpy as np

from masat import _core, lie, linear
from masat.arrays import Flags, Floats, Indices
from masat.graph import PoseGraph

_TURN = 2 * np.pi
# Of a turn, what an edge may keep for itself: with half of it, it is back where it was.
_MOST_SLACK = 0.5
# What a turn must promise, seen from the rotations alone: positions always add to it. In units of
# chi2.
_PROMISE = 3.0
# Edges that take more than this share of what the loop's own edge takes are of the same loop.
_SHARED = 0.5
# Radians: nodes that turn by less hold still while a turn is tried.
_STILL = 0.2


class Loop(NamedTuple):
    """The loops through an edge, and how they share a turn.

    Attributes
    ----------
    edge : int
    error : float
        Of its rotation, in radians.
    axis : ndarray, () or (3,)
        About which, in the world; in 2D its sign.
    turns : ndarray, (n,)
        By how much each node turns for the least change of all rotations, in radians.
    """

    edge: int
    error: float
    axis: Floats
    turns: Floats


class WeakLoops:
    """Tells around which loops of a graph another turn promises a lower chi2.

    Were rotations all there is, it would cost 4 pi w (pi s - |e|): w is the weight of an edge of
    the loop, e the error of its rotation, and s the share that it keeps of a turn, of which the
    rest of the loop takes the others. Source: Carlone and Censi, From angular manifolds to the
    integer lattice, T-RO 2014, who search for these integers, all at once and for rotations alone.

    Parameters
    ----------
    graph : PoseGraph
    unit : float
        The chi2 that counts as one.
    """

    def __init__(self, graph: PoseGraph, unit: float = 1.0) -> None:
        self._graph = graph
        self._promise = _PROMISE * unit
        # chi2 is this weight times the square of the angle.
        self._weight = 2 * linear.rotation_weights(graph)
        self._free = graph.elimination.free_nodes()
        self._place = np.full(len(graph.ids), -1, np.int32)
        self._place[self._free] = np.arange(len(self._free), dtype=np.int32)
        block = self._weight[:, None, None]
        still = np.zeros((len(graph.ids), 1, 1))
        self._minimizer = linear.Minimizer(graph, linear.Form(block, -block, block), still)

    def response(self, edge: int) -> Floats:
        """Return by how much each node turns for another turn at an edge, (n,), in radians."""
        i, j = self._graph.edge_indices[edge]
        pull = np.zeros((len(self._graph.ids), 1, 1))
        pull[j] = _TURN * self._weight[edge]
        pull[i] = -pull[j]
        return self._minimizer(pull).ravel()

    @cached_property
    def _slack(self) -> Floats:
        """Return what each edge keeps of a turn of its own, (m,), from 0 to 1."""
        i, j = self._place[self._graph.edge_indices.T]
        every = np.arange(len(self._free), dtype=np.int32)
        own = np.append(self._minimizer.matrix.inverse(every, every).ravel(), 0.0)
        inside = (i >= 0) & (j >= 0)
        joint = np.zeros(len(i))
        joint[inside] = self._minimizer.matrix.inverse(i[inside], j[inside]).ravel()
        slack: Floats = 1 - self._weight * (own[i] + own[j] - 2 * joint)
        return slack

    def weak_edges(self, poses: Floats) -> Indices:
        """Return the edges of the loops that promise something, the most promising first."""
        cost = self._cost(_errors(self._graph, poses)[0])
        slack = self._slack
        weak = np.flatnonzero((cost < -self._promise) & (slack < _MOST_SLACK) & (slack > 1e-9))
        order: Indices = weak[np.argsort(cost[weak], kind="stable")].astype(np.int32)
        return order

    def promising(self, poses: Floats) -> Iterator[Loop]:
        """Yield the loops that promise something, each once, by an edge that stands for it."""
        i, j = self._graph.edge_indices.T
        error, axis = _errors(self._graph, poses)
        of_a_better = np.zeros(len(error), np.bool_)
        for edge in self.weak_edges(poses):
            if of_a_better[edge]:
                continue
            turns = self.response(edge)
            taken = turns[j] - turns[i]
            taken[edge] -= _TURN
            of_a_better |= np.abs(taken) > _SHARED * abs(taken[edge])
            yield Loop(int(edge), float(error[edge]), axis[edge], turns)

    def _cost(self, error: Floats) -> Floats:
        cost: Floats = 2 * _TURN * self._weight * (np.pi * self._slack - error)
        return cost


def _errors(graph: PoseGraph, poses: Floats) -> tuple[Floats, Floats]:
    """Return the angles of the edges' rotation errors, (m,), and their axes in the world."""
    d = graph.dimension
    start, end = (poses[k] for k in graph.edge_indices.T)
    e = lie.local(graph.measurements, lie.between(start, end))[:, d:]
    if d == 2:
        return np.abs(e[:, 0]), np.where(e < 0, -1.0, 1.0)
    sine = np.sqrt(np.square(e).sum(axis=1))
    axis = _core.rotation_matrices(end) @ (e / np.maximum(sine, 1e-300)[:, None])[..., None]
    return 2 * np.arcsin(np.minimum(sine, 1.0)), axis[..., 0]


def turned(poses: Floats, axis: Floats, angles: Floats) -> Floats:
    """Return poses turned on the spot about an axis of the world."""
    d = 2 if poses.shape[1] == 3 else 3
    steps = np.zeros((len(poses), lie.DOF[d]))
    if d == 2:
        steps[:, 2] = angles * axis
    else:
        own = axis @ _core.rotation_matrices(poses)
        half = (angles / 2 + np.pi / 2) % np.pi - np.pi / 2
        steps[:, 3:] = np.sin(half)[:, None] * own
    return lie.retract(poses, steps)


def stilled(angles: Floats, own: Flags) -> Floats:
    """Return angles about the mean of some nodes, so that as many as possible hold still."""
    mean = np.exp(1j * angles[own]).mean()
    # Where no way is preferred, that of rounding errors must not be.
    away = np.angle(mean) if abs(mean) > 1e-9 else 0.0
    return np.where(own, angles - away, 0.0)


def apart(angles: Floats) -> Flags:
    """Return which nodes angles turn away from where they are."""
    apart: Flags = np.abs(angles - _TURN * np.round(angles / _TURN)) > _STILL
    return apart
