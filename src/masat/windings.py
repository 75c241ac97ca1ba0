"""Whole turns around weak loops: the local minima that one winding number tells from the next.

Along a loop the measured rotations must add up to whole turns, and how many these are is what most
local minima of a pose graph differ in: from one to the next, the edges of a loop share another
2 pi. A minimum is improved by trying a turn more or less where the loops are weak.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from typing import NamedTuple

import numpy as np

from masat import _core, lie, quadratic
from masat.arrays import Flags, Floats
from masat.graph import PoseGraph
from masat.optimizers import Iteration, optimize
from masat.optimizers.equations import edge_chi2, normal_equations
from masat.optimizers.termination import Report
from masat.regions import Surroundings

_TURN = 2 * np.pi
# Of a turn, what an edge may keep for itself: with half of it, it is back where it was.
_MOST_SLACK = 0.5
# What a turn must promise, seen from the rotations alone: positions always add to it. In units of
# chi2, or of the reduced chi2 where that is below 1 (`_unit`).
_PROMISE = 3.0
# Edges that take more than this share of what the loop's own edge takes are of the same loop.
_SHARED = 0.5
# Radians: nodes that turn by less hold still while a turn is tried.
_STILL = 0.2
# Such units above the minimum: up to the first, all nodes together are asked whether a turn pays;
# beyond the second, another way of spreading the turn is not worth a try.
_NEARLY, _FAR = 5.0, 80.0
# Of the nodes of a graph: loops that turn more are not worth lifting.
_LONG = 0.3
# A trial ends where so many more steps like the last would not bring it near.
_HOPE = 40
# Radians: errors below this are alike to a turn that goes where the loop bends most; a loop whose
# error has changed by less need not be tried again; and nodes that moved less are where they were.
_STRAIGHT = 0.01
# How many trials at the most: the first divided by the nodes of the graph, but not fewer than the
# second.
_WORK, _TRIALS = 1_000_000, 10
# chi2 this much lower, relatively, is another minimum; as between two solvers.
_LOWER = 1e-6


class Unwound(NamedTuple):
    """What came of `unwind`.

    Attributes
    ----------
    poses : ndarray, (n, 3) or (n, 7)
        At the lowest minimum met; those given if no loop was worth trying.
    turns : int
        How many were taken on the way.
    """

    poses: Floats
    turns: int


class Loop(NamedTuple):
    """The loops through an edge, and how they share a turn.

    Attributes
    ----------
    edge : int
    error : float
        Of its rotation, in radians.
    axis : ndarray, () or (3,)
        About which, in the world; in 2D its sign.
    even : ndarray, (n,)
        By how much each node turns for the least change of all rotations.
    """

    edge: int
    error: float
    axis: Floats
    even: Floats


def unwind(graph: PoseGraph) -> Unwound:
    """Go from near a minimum of chi2 to lower ones by whole turns around weak loops.

    Were rotations all there is, another turn around a loop would cost 4 pi w (pi s - |e|): w is the
    weight of an edge of it, e the error of its rotation, and s the share that it keeps of a turn,
    of which the rest of the loop takes the others. Loops where that is negative are tried, the most
    promising first: the turn is spread over the loop, evenly or to where it bends, and the nodes
    that turn are optimised. What lowers chi2 stands. Source: Carlone and Censi, From angular
    manifolds to the integer lattice, T-RO 2014, who search for these integers, all at once and for
    rotations alone.

    Parameters
    ----------
    graph : PoseGraph
        A graph with poses near a minimum.

    Returns
    -------
    Unwound
    """
    assert graph.poses is not None
    loops = _Loops(graph)
    poses, turns = graph.poses, 0
    refused: dict[int, float] = {}
    unit = _unit(graph)
    left = max(_TRIALS, _WORK // len(graph.ids))
    if next(loops.promising(poses, unit), None) is not None:
        trials = _Trials(graph, unit)
        moved = True
        while moved:
            moved = False
            poses, chi2 = _minimum(graph, poses)
            bent = loops.bent(poses)
            for loop in loops.promising(poses, unit):
                if abs(loop.error - refused.get(loop.edge, np.inf)) < _STRAIGHT:
                    continue
                if left == 0:
                    break
                left -= 1
                beyond = trials.turned(poses, chi2, loop.axis, loop.even)
                if chi2 * (1 - _LOWER) <= beyond[1] < chi2 + _FAR * unit:
                    beyond = trials.turned(poses, chi2, loop.axis, bent.response(loop.edge))
                if beyond[1] < chi2 * (1 - _LOWER):
                    (poses, chi2), turns, moved = beyond, turns + 1, True
                else:
                    refused[loop.edge] = loop.error
    return Unwound(poses, turns)


def nodes_of_weak_loops(graph: PoseGraph) -> Flags:
    """Return which nodes another turn around one of the loops that promise something would turn.

    Loops of more than `_LONG` of the nodes do not count.
    """
    assert graph.poses is not None
    nodes = np.zeros(len(graph.ids), np.bool_)
    for loop in _Loops(graph).promising(graph.poses, _unit(graph)):
        own = graph.components == graph.components[graph.edge_indices[loop.edge, 0]]
        apart = _apart(_stilled(loop.even, own))
        if np.count_nonzero(apart) <= _LONG * len(nodes):
            nodes |= apart
    return nodes


def _unit(graph: PoseGraph) -> float:
    """Return the chi2 that is one: less where the information promises less than it keeps."""
    free = len(graph.ids) - len(graph.anchors)
    freedom = graph.dof * (len(graph.edges) - free)
    return min(1.0, float(edge_chi2(graph).sum()) / freedom) if freedom > 0 else 1.0


def _minimum(graph: PoseGraph, poses: Floats, report: Report | None = None) -> tuple[Floats, float]:
    """Return the poses of the minimum that an optimiser finds from some, and chi2 there."""
    result = optimize(
        graph.with_poses(poses), relative_tolerance=1e-8, max_iterations=50, report=report
    )
    assert result.graph.poses is not None
    return result.graph.poses, result.chi2


class _Loops:
    """The Laplacian of the rotations: how the edges of a graph share the turns of its loops."""

    def __init__(self, graph: PoseGraph, stretch: Floats | float = 1.0) -> None:
        """Take a graph, and by how much its edges give way more than their information says."""
        self._graph = graph
        # chi2 is this weight times the square of the angle.
        self._weight = 2 * quadratic.rotation_weights(graph) / stretch
        self._free = graph.elimination.free_nodes()
        self._place = np.full(len(graph.ids), -1, np.int32)
        self._place[self._free] = np.arange(len(self._free), dtype=np.int32)
        block = self._weight[:, None, None]
        still = np.zeros((len(graph.ids), 1, 1))
        self._minimiser = quadratic.Minimiser(graph, quadratic.Form(block, -block, block), still)

    def response(self, edge: int) -> Floats:
        """Return by how much each node turns for another turn at an edge, (n,), in radians."""
        i, j = self._graph.edge_indices[edge]
        pull = np.zeros((len(self._graph.ids), 1, 1))
        pull[j] = _TURN * self._weight[edge]
        pull[i] = -pull[j]
        return self._minimiser(pull).ravel()

    @cached_property
    def _slack(self) -> Floats:
        """Return what each edge keeps of a turn of its own, (m,), from 0 to 1."""
        i, j = self._place[self._graph.edge_indices.T]
        every = np.arange(len(self._free), dtype=np.int32)
        own = np.append(self._minimiser.matrix.inverse(every, every).ravel(), 0.0)
        inside = (i >= 0) & (j >= 0)
        joint = np.zeros(len(i))
        joint[inside] = self._minimiser.matrix.inverse(i[inside], j[inside]).ravel()
        slack: Floats = 1 - self._weight * (own[i] + own[j] - 2 * joint)
        return slack

    def bent(self, poses: Floats) -> _Loops:
        """Return the loops if their edges gave way the more, the larger their errors are."""
        return _Loops(self._graph, _errors(self._graph, poses)[0] + _STRAIGHT)

    def promising(self, poses: Floats, unit: float) -> Iterator[Loop]:
        """Yield the loops, one an edge that stands for it, that another turn promises to better."""
        graph = self._graph
        i, j = graph.edge_indices.T
        slack = self._slack
        error, axis = _errors(graph, poses)
        cost = 2 * _TURN * self._weight * (np.pi * slack - error)
        weak = np.flatnonzero((cost < -_PROMISE * unit) & (slack < _MOST_SLACK) & (slack > 1e-9))
        of_a_better = np.zeros(len(cost), np.bool_)
        for edge in weak[np.argsort(cost[weak], kind="stable")]:
            if of_a_better[edge]:
                continue
            turns = self.response(edge)
            taken = turns[j] - turns[i]
            taken[edge] -= _TURN
            of_a_better |= np.abs(taken) > _SHARED * abs(taken[edge])
            yield Loop(int(edge), float(error[edge]), axis[edge], turns)


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


def _turn(poses: Floats, axis: Floats, angles: Floats) -> Floats:
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


def _stilled(angles: Floats, own: Flags) -> Floats:
    """Return angles about the mean of some nodes, so that as many as possible hold still."""
    return np.where(own, angles - np.angle(np.exp(1j * angles[own]).mean()), 0.0)


def _apart(angles: Floats) -> Flags:
    """Return which nodes angles turn away from where they are."""
    apart: Flags = np.abs(angles - _TURN * np.round(angles / _TURN)) > _STILL
    return apart


class _Trials:
    """Tries turns on the nodes around a loop, the others held still."""

    def __init__(self, graph: PoseGraph, unit: float) -> None:
        self._graph = graph
        self._nearly = _NEARLY * unit
        self._surroundings = Surroundings(graph)
        self._labels = graph.components
        anchors = graph.index(graph.anchors)
        held = np.bincount(self._labels[anchors], minlength=int(self._labels.max()) + 1)
        # What holds only the gauge may turn with the rest, and is put back afterwards.
        self._gauge = anchors[held[self._labels[anchors]] == 1]
        self._held = anchors[held[self._labels[anchors]] > 1]

    def turned(
        self, poses: Floats, chi2: float, axis: Floats, angles: Floats
    ) -> tuple[Floats, float]:
        """Return the poses at the minimum beyond a turn, and chi2 there."""
        graph = self._graph
        own = np.abs(angles) > 0
        label = self._labels[np.argmax(own)]
        gauge = self._gauge[self._labels[self._gauge] == label]
        if len(gauge):
            angles = _stilled(angles, self._labels == label)
        apart = _apart(angles)
        if not apart.any():
            return poses, chi2
        inside = self._surroundings.around(apart)
        inside[self._held] = False
        part = self._surroundings.region(poses, inside).graph
        assert part.poses is not None
        nodes = part.ids
        start = _turn(part.poses, axis, np.where(inside[nodes], angles[nodes], 0.0))
        before = normal_equations(part).chi2(part.poses)
        result = optimize(
            part.with_poses(quadratic.settle(part, start)),
            max_iterations=30,
            absolute_tolerance=self._nearly / 500,
            report=_Hope(before + self._nearly),
        )
        assert result.graph.poses is not None
        out = poses.copy()
        out[nodes] = result.graph.poses
        after = chi2 + result.chi2 - before
        if np.abs(lie.local(poses[nodes], out[nodes])).max() < _STRAIGHT:
            return poses, chi2
        if len(gauge):
            own = self._labels == label
            back = lie.compose(poses[gauge[0]], lie.inverse(out[gauge[0]]))
            out[own] = lie.compose(back, out[own])
            out[gauge] = poses[gauge]
        if chi2 * (1 - _LOWER) <= after < chi2 + self._nearly:
            # Nearly as low: with all nodes free it may be lower.
            return _minimum(graph, out, _Hope(chi2 * (1 - _LOWER), after))
        return out, after


class _Hope:
    """Stops an optimiser where many more steps like the last would not bring chi2 below a mark."""

    def __init__(self, mark: float, chi2: float = np.inf) -> None:
        self._mark, self._last = mark, chi2

    def __call__(self, step: Iteration) -> bool:
        """Return whether to stop after an iteration."""
        gained, self._last = self._last - step.chi2, step.chi2
        return step.chi2 - self._mark > _HOPE * gained
