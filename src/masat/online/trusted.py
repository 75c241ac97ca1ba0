"""The edges of a robust map that are not judged."""

from __future__ import annotations

from collections import Counter

import numpy as np

from masat import lie
from masat.arrays import Floats

# Edges whose information is kept before variances are taken of all at once.
_BATCH = 256


class TrustedEdges:
    """Which nodes trusted edges lead to, and how their variances add up along the nodes.

    What a step adds or removes counts at once, and is undone by `forget` until `commit`.

    Parameters
    ----------
    dimension : int
        2 or 3.
    """

    def __init__(self, dimension: int) -> None:
        dof = lie.DOF[dimension]
        self._ends: dict[int, tuple[int, int]] = {}
        self._edges_of: Counter[int] = Counter()
        self._added: list[int] = []
        self._removed: dict[int, tuple[int, int]] = {}
        # Of edges that are not in the sums yet, the newer node and the information.
        self._open: list[tuple[int, Floats]] = []
        self._committed = 0
        self._variances: Floats = np.zeros((64, dof))
        self._sums: Floats = np.zeros((0, dof))

    def reaches(self, node: int) -> bool:
        """Whether a trusted edge leads to a node, given by its id."""
        return self._edges_of[node] > 0

    def add(self, number: int, ends: tuple[int, int], newer: int, information: Floats) -> None:
        """Trust an edge, given the ids of its ends and the index of the newer one."""
        self._count(number, ends)
        self._added.append(number)
        self._open.append((newer, information.copy()))

    def remove(self, numbers: list[int]) -> None:
        """Remove edges; other numbers are skipped."""
        for number in numbers:
            if number in self._ends:
                ends = self._ends.pop(number)
                self._edges_of.subtract(ends)
                self._removed[number] = ends

    def commit(self) -> None:
        """Make what this step has added and removed final."""
        self._added.clear()
        self._removed.clear()
        self._committed = len(self._open)
        if self._committed > _BATCH:
            self._take_variances()

    def forget(self) -> None:
        """Undo what this step has added and removed."""
        for number, ends in self._removed.items():
            self._count(number, ends)
        for number in self._added:
            self._edges_of.subtract(self._ends.pop(number))
        self._added.clear()
        self._removed.clear()
        del self._open[self._committed :]

    def variance_along(self, nodes: int) -> Floats:
        """Return the sums of variances up to each of so many nodes, by index, (nodes, dof).

        Edges between nodes whose sums were asked for before have no part in them.
        """
        self._take_variances()
        known = len(self._sums)
        if known < nodes:
            self._make_room(nodes)
            begin = self._sums[-1:].sum(axis=0)
            more = begin + np.cumsum(self._variances[known:nodes], axis=0)
            self._sums = np.concatenate([self._sums, more])
        return self._sums[:nodes]

    def _count(self, number: int, ends: tuple[int, int]) -> None:
        self._ends[number] = ends
        self._edges_of.update(ends)

    def _take_variances(self) -> None:
        if self._open:
            newer = np.array([node for node, _ in self._open])
            variances = np.linalg.inv(np.array([information for _, information in self._open]))
            self._make_room(int(newer.max()) + 1)
            np.maximum.at(self._variances, newer, np.einsum("kii->ki", variances))
        self._open.clear()
        self._committed = 0

    def _make_room(self, nodes: int) -> None:
        if nodes > len(self._variances):
            more = np.zeros((2 * nodes - len(self._variances), self._variances.shape[1]))
            self._variances = np.concatenate([self._variances, more])
