"""Shifts by 2 pi along strings of edges, between two short cycles that may close either way.

Where noise is high, a short cycle of measured rotations may close at either side of pi. In 3D a
local minimum differs from a lower one by such a decision at two cycles, or at one and the border of
the graph, and by a shift of the edges that a string from one cycle to the other crosses.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np

from masat.arrays import Floats, Indices
from masat.graph import PoseGraph
from masat.optimality.cycles import rotation_problem, rotation_residuals, rotation_weight

_TURN = 2 * np.pi
# Edges of a short cycle at the most, and cycles that a string crosses at the most.
_MAX_EDGES, _MAX_CROSSED = 10, 16
# Radians: sums of a cycle's rotation residuals from which on a string begins there; and from which
# on one of at most so many edges ends there. The border of the graph ends such a string, too.
_FIRST_SUM, _LAST_SUM, _SHORT = 2.6, 1.8, 8
# Strings whose costs are computed at once.
_MAX_STRINGS = 4000
# Nodes up to which short cycles are sought: some tenths of a second.
_MAX_NODES = 5000


class String(NamedTuple):
    """Edges that are shifted together.

    Attributes
    ----------
    cost : float
        By how much the shift changes chi2, if rotations are all there is.
    edges : ndarray, (k,)
    vectors : ndarray, (k, c)
        The shifts: angles of 2 pi, or rotation vectors of this length in the world.
    """

    cost: float
    edges: Indices
    vectors: Floats


class Strings:
    """Finds strings of edges that promise a lower chi2 when they are shifted by 2 pi.

    The cost of shifts k by 2 pi about an axis a is 4 pi^2 k' P k + 4 pi a' sum(k w e): w are the
    weights of the edges, e the rotation residuals as vectors, and P what the least squares of all
    rotations leave of a shift. It is least for the axis against the sum.

    Parameters
    ----------
    graph : PoseGraph
        The graph.
    """

    def __init__(self, graph: PoseGraph) -> None:
        self._graph = graph
        self._weight = rotation_weight(graph)
        self._problem = rotation_problem(graph, self._weight)
        self._free = graph.elimination.free_nodes()
        small = len(graph.ids) <= _MAX_NODES
        self._cycles = _short_cycles(graph) if small else []
        self._through: list[list[int]] = [[] for _ in graph.edges]
        for number, cycle in enumerate(self._cycles):
            for edge in cycle:
                self._through[edge].append(number)

    def at(self, poses: Floats) -> list[String]:
        """Return the strings that promise a lower chi2, the most promising first."""
        angle, axis = rotation_residuals(self._graph, poses)
        residual = angle[:, None] * axis
        found: dict[frozenset[int], dict[int, int]] = {}
        sums = self._sums(residual)
        for number in np.flatnonzero(sums > _FIRST_SUM).tolist():
            for string in self._strings_from(number, sums):
                found.setdefault(frozenset(string), string)
        strings = sorted(found.values(), key=len)[:_MAX_STRINGS]
        if not strings:
            return []
        i, j = self._graph.edge_indices.T
        term = np.zeros((len(poses), 1, len(strings)))
        for column, string in enumerate(strings):
            for edge, sign in string.items():
                term[j[edge], 0, column] += _TURN * self._weight[edge] * sign
                term[i[edge], 0, column] -= _TURN * self._weight[edge] * sign
        rotations = np.zeros((len(poses), len(strings)))
        term = np.ascontiguousarray(term[self._free])
        rotations[self._free] = self._problem.matrix.solve(term)[:, 0]
        out = []
        for column, string in enumerate(strings):
            edges = np.fromiter(string, np.int32)
            signs = np.fromiter(string.values(), np.float64)
            kept = _TURN * signs - rotations[j[edges], column] + rotations[i[edges], column]
            slope = (signs * self._weight[edges]) @ residual[edges]
            length = float(np.linalg.norm(slope))
            stiffness = float((signs * self._weight[edges]) @ kept)
            cost = _TURN * stiffness - 2 * _TURN * length
            if cost < 0:
                vectors = -_TURN * np.outer(signs, slope / length)
                out.append(String(cost, edges, vectors))
        out.sort(key=lambda string: string.cost)
        return out

    def _sums(self, residual: Floats) -> Floats:
        """Return the lengths of the sums of the residuals along each short cycle."""
        sums = [
            np.linalg.norm(np.array(list(cycle.values())) @ residual[list(cycle)])
            for cycle in self._cycles
        ]
        return np.array(sums)

    def _strings_from(self, first: int, sums: Floats) -> list[dict[int, int]]:
        """Return the shortest strings from a cycle to other doubtful ones, and to the border."""
        strings: dict[int, dict[int, int]] = {first: {}}
        last: dict[int, int] = {first: -1}
        out = []
        queue = deque([first])
        while queue:
            number = queue.popleft()
            string, cycle = strings[number], self._cycles[number]
            if len(string) == _MAX_CROSSED:
                continue
            for edge in cycle:
                if edge in string or len(self._through[edge]) > 2:
                    continue
                sign = 1
                if string:
                    # Between its ends a string crosses each cycle in and out.
                    entered = last[number]
                    sign = -string[entered] * cycle[entered] * cycle[edge]
                longer = {**string, edge: sign}
                others = [other for other in self._through[edge] if other != number]
                short = len(longer) <= _SHORT
                if not others and short:
                    out.append(longer)
                elif others and others[0] not in strings:
                    strings[others[0]], last[others[0]] = longer, edge
                    queue.append(others[0])
                    if sums[others[0]] > (_LAST_SUM if short else _FIRST_SUM):
                        out.append(longer)
        return out


def _short_cycles(graph: PoseGraph) -> list[dict[int, int]]:
    """Return short cycles: their edges, with 1 along the walk and -1 against it.

    They are a shortest one through each edge, and where that is the only one through an edge, the
    shortest ones through it and each edge at its end.
    """
    ends = graph.edge_indices.tolist()
    around: list[list[tuple[int, int, int]]] = [[] for _ in graph.ids]
    for edge, (i, j) in enumerate(ends):
        around[i].append((j, edge, 1))
        around[j].append((i, edge, -1))
    found: dict[frozenset[int], dict[int, int]] = {}
    count = [0] * len(ends)

    def add(cycle: dict[int, int]) -> None:
        if len(cycle) > 2 and frozenset(cycle) not in found:
            found[frozenset(cycle)] = cycle
            for edge in cycle:
                count[edge] += 1

    for edge, (i, j) in enumerate(ends):
        walk = _shortest_walk(around, j, i, edge)
        if walk:
            add({edge: 1, **walk})
    for edge, (i, j) in enumerate(ends):
        if count[edge] != 1:
            continue
        cycles = []
        for node, through, sign in around[j]:
            if through == edge or node == i:
                continue
            walk = _shortest_walk(around, node, i, edge, j)
            if walk:
                cycles.append({edge: 1, through: sign, **walk})
        for cycle in sorted(cycles, key=len):
            if all(count[other] < 2 for other in cycle):
                add(cycle)
    return list(found.values())


def _shortest_walk(
    around: list[list[tuple[int, int, int]]], first: int, last: int, without: int, avoided: int = -1
) -> dict[int, int] | None:
    """Return the edges of a shortest walk between two nodes without an edge, if it is short."""
    came: dict[int, tuple[int, int, int]] = {first: (-1, -1, 0)}
    depth = {first: 0}
    queue = deque([first])
    while queue and last not in came:
        node = queue.popleft()
        if depth[node] == _MAX_EDGES - 1:
            break
        for other, through, sign in around[node]:
            if through != without and other != avoided and other not in came:
                came[other], depth[other] = (node, through, sign), depth[node] + 1
                queue.append(other)
    if last not in came:
        return None
    walk, node = {}, last
    while node != first:
        node, through, sign = came[node]
        walk[through] = sign
    return walk
