"""A lower bound on chi2 of boxes: in each, relative rotations of a few pairs of nodes are confined.

Where the relaxation of the whole problem is not tight, two parts of the graph may rotate either way
relative to each other, and the relaxation takes a mixture of both. The circle of such a rotation is
cut into arcs. Within an arc of the middle m and the half-width h, a rotation r has
k (r - m)^2 <= k h^2 for any k > 0, r - m being the shorter way round. So chi2 plus the edge
k (r - m)^2, which holds the two nodes together, exceeds chi2 by k h^2 at most, and a bound of that
graph less k h^2 is one of chi2 for all poses in the arc.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from masat.arrays import Floats
from masat.assembly import AssembledGraph, with_edges
from masat.errors import InitializationError
from masat.graph import PoseGraph
from masat.optimality.bounds import TIGHT, TangentRelaxation
from masat.optimality.relaxation import lifted_operations
from masat.optimizers import Result, optimize
from masat.optimizers.equations import normal_equations
from masat.progress import Progress

# Pairs that divide a box, and boxes whose relaxation is minimized at a higher rank: more are not
# worth their time. Most minima that can be proven take less than 20.
_MAX_PAIRS, _MAX_LIFTED = 4, 60
# Those times the operations of a factorization at that rank, a minute on one core with all that
# goes with them. Where there is not enough for so many, none is begun.
_MAX_OPERATIONS, _FEW_LIFTED = 6e10, 4
# Boxes for each of those.
_BOXES = 5
_ITERATIONS = 60
# Fractions of a box's chi2, its edges included, that a bound may give up, from the smallest on.
_ALLOWED = (0.0, TIGHT / 10)
_ALLOWED_LIFTED = (TIGHT / 10, 1e-5, 3e-5, 1e-4, 2e-4, 5e-4, 1e-3)
# Length of the product of two nodes' frames at a higher rank above which they do not mix.
_UNMIXED = 0.99
# What the edges of a box may exceed chi2 by, as a fraction of what its bound lacks, where narrower
# arcs are of no use.
_WORTHWHILE = 0.01
# Radians: another pair divides a box only if all its arcs are narrower. Wide arcs bound little.
_NARROW = 1.1
# A smaller variance, as a fraction of those of the two nodes, is lost in rounding.
_LOST = 1e-10

Pair = tuple[int, int]


class Box(NamedTuple):
    """Poses in which the relative rotation of each pair is in an arc.

    Attributes
    ----------
    arcs : dict
        The first and the last angle of each pair of nodes, which are given by their indices.
    poses : ndarray, (n, 3)
        Where an optimizer begins.
    """

    arcs: dict[Pair, tuple[float, float]]
    poses: Floats


def branched_bound(
    graph: PoseGraph, chi2: float, *, seed: int = 0, progress: Progress | None = None
) -> tuple[float, PoseGraph | None]:
    """Return a number that chi2 of no poses lies below, and a graph at lower poses if any are met.

    Arcs of the pair that the relaxation mixes most are bounded one by one and, where that is not
    enough, halved or divided by another pair. Source of the method: Land and Doig, An automatic
    method of solving discrete programming problems, 1960.

    Parameters
    ----------
    graph : PoseGraph
        A graph in 2D, at the minimum in question.
    chi2 : float
        Its chi2.
    seed : int
        Seed of the random noise that is added when a rank is raised.
    progress : Progress, optional
        What limits the time.

    Returns
    -------
    bound : float
        0 if lower poses are met, and where it gives up: after too many boxes, at once in graphs
        where few would take too long, where more than four pairs mix, at the end of the time
        budget, and where memory does not allow the higher rank.
    lower : PoseGraph or None
        The graph at poses of a lower chi2.
    """
    return _Branching(graph, chi2, seed, progress or Progress()).bound()


class _Branching:
    """The boxes that are still to be bounded."""

    def __init__(self, graph: PoseGraph, chi2: float, seed: int, progress: Progress) -> None:
        assert graph.poses is not None
        self._progress = progress
        self._graph, self._poses, self._chi2, self._seed = graph, graph.poses, chi2, seed
        self._enough = chi2 * (1 - TIGHT / 4)
        self._stiffness: dict[Pair, float] = {}
        affordable = _MAX_OPERATIONS / max(lifted_operations(graph), 1.0)
        self._lifts_left = int(min(affordable, _MAX_LIFTED))
        self._equations = normal_equations(graph, 1)
        self._equations.linearize(graph.poses)
        self._is_minimum = self._equations.factorize(np.zeros_like(self._equations.rhs())) < 0
        self._index = np.full(len(graph.ids), -1, np.int32)
        free = graph.elimination.free_nodes()
        self._index[free] = np.arange(len(free), dtype=np.int32)

    def bound(self) -> tuple[float, PoseGraph | None]:
        """See `branched_bound`."""
        waiting, lowest = [Box({}, self._poses)], self._chi2
        if self._lifts_left < _FEW_LIFTED:
            return 0.0, None
        for _ in range(_BOXES * self._lifts_left):
            if not waiting:
                return lowest, None
            if self._progress.over or not self._is_minimum:
                break
            box = waiting.pop()
            result = self._minimum(box)
            if self._equations.chi2(result.poses) < self._enough:
                return 0.0, self._graph.with_poses(result.poses)
            found = self._bounded(box, result)
            if isinstance(found, float):
                lowest = min(lowest, found)
            elif found is None:
                break
            else:
                waiting += found
        return 0.0, None

    def _minimum(self, box: Box) -> Result:
        """Return a minimum of the graph with an edge for each pair of a box."""
        return optimize(
            self._confined(box),
            "levenberg_marquardt",
            relative_tolerance=1e-12,
            max_iterations=_ITERATIONS,
            progress=self._progress,
        )

    def _bounded(self, box: Box, result: Result) -> float | list[Box] | None:
        """Return a bound of a box if it is high enough, else smaller boxes, or None to give up."""
        exceeds = self._exceeds(box)
        slack = result.chi2 - exceeds - self._enough
        if slack < 0:
            return self._divided(box, self._widest(box), result.poses)
        relaxation = TangentRelaxation(result.graph, result.chi2)
        bound = relaxation.bound(_ALLOWED) - exceeds
        if bound >= self._enough:
            return bound
        if self._lifts_left == 0:
            return None
        self._lifts_left -= 1
        allowed = [a for a in _ALLOWED_LIFTED[1:] if a * result.chi2 < slack]
        try:
            lifted = relaxation.lifted(self._seed, (_ALLOWED_LIFTED[0], *allowed))
        except InitializationError:
            return None
        if lifted is None:
            return None
        if lifted.bound - exceeds >= self._enough:
            return lifted.bound - exceeds
        nearer = self._lower_in(box, result.chi2, relaxation.rounded(lifted.unknowns))
        if nearer is not None:
            return [nearer]
        pair, length = _most_mixed(lifted.unknowns)
        missing = self._enough - (lifted.bound - exceeds)
        if pair in box.arcs or (box.arcs and (length > _UNMIXED or _width(box) > _NARROW)):
            # Narrower arcs raise the bound by what the edges exceed chi2 by at most.
            if exceeds < _WORTHWHILE * missing:
                return None
            return self._divided(box, pair if pair in box.arcs else self._widest(box), result.poses)
        if len(box.arcs) == _MAX_PAIRS or not self._is_loose(pair):
            return None
        middle = self._angle(pair)
        arcs = {**box.arcs, pair: (middle - np.pi, middle + np.pi)}
        return self._divided(box._replace(arcs=arcs), pair, result.poses)

    def _lower_in(self, box: Box, chi2: float, rounded: PoseGraph | None) -> Box | None:
        """Return a box again, to begin at rounded poses, if these lead to a lower minimum of it."""
        if rounded is None or rounded.poses is None:
            return None
        again = box._replace(poses=rounded.poses)
        found = self._minimum(again)
        return again._replace(poses=found.poses) if found.chi2 < chi2 * (1 - TIGHT) else None

    def _divided(self, box: Box, pair: Pair, poses: Floats) -> list[Box]:
        """Return the boxes that divide an arc: in three around the minimum, or in two."""
        first, last = box.arcs[pair]
        angle = self._angle(pair)
        angle += 2 * np.pi * np.round(((first + last) / 2 - angle) / (2 * np.pi))
        if first < angle < last:
            near = max(last - angle, angle - first) / 3
            cuts = [first, max(first, angle - near), min(last, angle + near), last]
        else:
            cuts = [first, (first + last) / 2, last]
        return [Box({**box.arcs, pair: (a, b)}, poses) for a, b in pairwise(cuts) if a < b]

    def _widest(self, box: Box) -> Pair:
        return max(box.arcs, key=lambda pair: self._exceeds(Box({pair: box.arcs[pair]}, box.poses)))

    def _exceeds(self, box: Box) -> float:
        """Return by how much the edges of a box raise chi2 within it at most."""
        return sum(self._weight(pair) * ((b - a) / 2) ** 2 for pair, (a, b) in box.arcs.items())

    def _confined(self, box: Box) -> PoseGraph:
        if not box.arcs:
            return self._graph.with_poses(box.poses)
        pairs = np.array(list(box.arcs))
        measurements, information = np.zeros((len(pairs), 3)), np.zeros((len(pairs), 3, 3))
        middles = np.array([(a + b) / 2 for a, b in box.arcs.values()])
        measurements[:, 2] = np.arctan2(np.sin(middles), np.cos(middles))
        information[:, 2, 2] = [self._weight(pair) for pair in box.arcs]
        confined: AssembledGraph = with_edges(
            self._graph, self._graph.ids[pairs], measurements, information
        )
        return confined.with_poses(box.poses)

    def _angle(self, pair: Pair) -> float:
        """Return the relative rotation of a pair at the minimum."""
        return float(self._poses[pair[1], 2] - self._poses[pair[0], 2])

    def _is_loose(self, pair: Pair) -> bool:
        """Whether the relative rotation of a pair has a variance at the minimum; keeps it."""
        rows, columns = self._index[[*pair, pair[0]]], self._index[[*pair, pair[1]]]
        free = (rows >= 0) & (columns >= 0)
        blocks = np.zeros(3)
        blocks[free] = self._equations.inverse(rows[free], columns[free])[:, 2, 2]
        variance = float(blocks[0] + blocks[1] - 2 * blocks[2])
        if not variance > _LOST * float(blocks[0] + blocks[1]):
            return False
        self._stiffness[pair] = 1 / variance
        return True

    def _weight(self, pair: Pair) -> float:
        """Return the weight of the edge of a pair: the stiffness of its rotation at the minimum."""
        return self._stiffness[pair]


def _width(box: Box) -> float:
    """Return the width of a box's widest arc."""
    return max(last - first for first, last in box.arcs.values())


def _most_mixed(unknowns: Floats) -> tuple[Pair, float]:
    """Return nodes whose relative rotation is mixed from several, and how much it is.

    Parameters
    ----------
    unknowns : ndarray, (n, 4, p)
        Of a relaxation at the rank p.

    Returns
    -------
    pair : tuple of int
        Indices of the nodes, in ascending order.
    length : float
        That of the product of their frames: 1 if it is a rotation.
    """
    frames = unknowns[:, 0] + 1j * unknowns[:, 1]
    _, vectors = np.linalg.eigh(frames.conj().T @ frames)
    across = np.square(np.abs(frames @ vectors[:, :-1])).sum(axis=1)
    one = other = int(np.argmax(across))
    length = 1.0
    # Each node looks for its own counterpart in turn.
    for _ in range(3):
        products = np.abs(frames @ frames[one].conj())
        one, other = int(np.argmin(products)), one
        length = float(products[one])
    return (min(one, other), max(one, other)), length
