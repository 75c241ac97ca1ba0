"""The separators between the parts of a graph, and their tree."""

from __future__ import annotations

import heapq
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from masat import _core
from masat.arrays import Ids, Indices
from masat.errors import PartitionError
from masat.graph import PoseGraph
from masat.parts.covers import smallest_cover
from masat.structure import nested_dissection

# By this fraction a tree may be larger than the share of its half. With less of it separators are
# larger.
_UNEVENNESS = 0.1


@dataclass(frozen=True, eq=False)
class Dissection:
    """Which piece of a graph each node is in, and the tree of the pieces.

    A piece is a part or a separator. Parts come first, children before their parents: a node of a
    piece has edges only to the same piece, to those above it, to those below it, and to fixed
    nodes.

    Attributes
    ----------
    piece : ndarray of int32, (n,)
        The piece of each node; -1 for nodes that are not optimized.
    parent : list of int
        The separator above each piece, or -1.
    parts : int
        Number of parts.
    """

    piece: Indices
    parent: list[int]
    parts: int


def dissect(graph: PoseGraph, labels: Ids) -> Dissection:
    """Return the separators between given parts.

    The parts are halved by their numbers, again and again. Each time the separator is the smallest
    set of nodes that covers the edges between the halves.
    """
    parts = int(labels.max()) + 1
    pairs = graph.edge_indices.astype(np.int64)
    pairs = pairs[(labels[pairs] >= 0).all(axis=1) & (labels[pairs[:, 0]] != labels[pairs[:, 1]])]
    inside = labels >= 0
    separators: list[tuple[int, int, Ids]] = []  # from the root down: first part, end, nodes
    waiting = [(0, parts, pairs)]
    while waiting:
        first, end, own = waiting.pop(0)
        if end - first < 2:
            continue
        middle = first + (end - first) // 2
        own = own[inside[own].all(axis=1)]
        upper = labels[own] >= middle
        across = upper[:, 0] != upper[:, 1]
        cut = own[across]
        cut = np.where(upper[across][:, :1], cut[:, ::-1], cut)
        nodes = smallest_cover(cut[:, 0], cut[:, 1]) if len(cut) else np.empty(0, np.int64)
        inside[nodes] = False
        separators.append((first, end, nodes))
        left = ~upper.any(axis=1)
        waiting += [(first, middle, own[left]), (middle, end, own[upper.all(axis=1)])]
    return _numbered(labels, parts, separators)


def _numbered(labels: Ids, parts: int, separators: list[tuple[int, int, Ids]]) -> Dissection:
    """Return the pieces, numbered; separators without nodes are left out."""
    piece = labels.astype(np.int32)
    kept = [s for s in separators if len(s[2])][::-1]
    parent = [-1] * (parts + len(kept))
    for k, (first, end, nodes) in enumerate(kept, start=parts):
        piece[nodes] = k
        for below in [*range(first, end), *range(parts, k)]:
            inside = below < parts or (first <= kept[below - parts][0] < end)
            if inside and parent[below] < 0:
                parent[below] = k
    return Dissection(piece, parent, parts)


def dissect_evenly(graph: PoseGraph, parts: int) -> Dissection:
    """Return a number of parts of about as many nodes each, and the separators between them.

    They are subtrees of the elimination tree that nested dissection leads to. A forest of subtrees
    is halved again and again: roots go to the separator until no tree is too large for its half.
    In graphs of few nodes a part parts may be twice as large as others, or empty.
    Source: Karypis and Kumar, A fast and high quality multilevel scheme for partitioning irregular
    graphs, 1998.
    """
    free = graph.structure.free
    if not 1 <= parts <= len(free):
        raise PartitionError(
            "the number of parts must be from 1 to the number of nodes that are optimized, "
            f"{len(free)}; got {parts}"
        )
    labels = np.full(len(graph), -1, np.int64)
    if parts == 1:
        labels[free] = 0
        return Dissection(labels.astype(np.int32), [-1], 1)
    tree = _Tree(graph)
    separators: list[tuple[int, int, Ids]] = []
    waiting = [(0, parts, tree.roots)]
    while waiting:
        first, end, forest = waiting.pop(0)
        if end - first == 1:
            for root in forest:
                labels[tree.nodes[root + 1 - tree.size[root] : root + 1]] = first
            continue
        middle = first + (end - first) // 2
        top, left, right = tree.halved(forest, (middle - first) / (end - first))
        separators.append((first, end, tree.nodes[top]))
        waiting += [(first, middle, left), (middle, end, right)]
    return _numbered(labels, parts, separators)


class _Tree:
    """The elimination tree of a nested dissection, its nodes in postorder.

    Attributes
    ----------
    nodes : ndarray of int64, (f,)
        The index in the graph of each.
    size : list of int
        How many nodes there are from each down: it is the last of so many in a row.
    roots : list of int
        Those without a parent.
    """

    def __init__(self, graph: PoseGraph) -> None:
        fixed = np.ones(len(graph), np.bool_)
        fixed[graph.structure.free] = False
        as_numbered = np.arange(len(graph.structure.free), dtype=np.int32)
        unordered = _core.Elimination(graph.topology, fixed, as_numbered)
        order = nested_dissection(unordered, _UNEVENNESS)
        if order is None:
            raise PartitionError(
                "cutting a graph into parts needs the package pymetis; install it, or give the "
                "part of each node"
            )
        elimination = _core.Elimination(graph.topology, fixed, order)
        self.nodes: Ids = elimination.free_nodes()[elimination.order()].astype(np.int64)
        self.size = [1] * len(order)
        self._children: list[list[int]] = [[] for _ in order]
        self.roots: list[int] = []
        for k, parent in enumerate(elimination.parents().tolist()):
            if parent < 0:
                self.roots.append(k)
            else:
                self.size[parent] += self.size[k]
                self._children[parent].append(k)

    def halved(self, forest: list[int], share: float) -> tuple[list[int], list[int], list[int]]:
        """Return the nodes above two halves of a forest, and the halves, the first with a share."""
        heap = [(-self.size[root], root) for root in forest]
        heapq.heapify(heap)
        total, top = sum(self.size[root] for root in forest), list[int]()
        while heap and -heap[0][0] > (1 + _UNEVENNESS) * max(share, 1 - share) * total:
            _, root = heapq.heappop(heap)
            top.append(root)
            total -= 1
            for child in self._children[root]:
                heapq.heappush(heap, (-self.size[child], child))
        halves: tuple[list[int], list[int]] = [], []
        missing = [share * total, (1 - share) * total]
        while heap:
            size, root = heapq.heappop(heap)
            half = int(missing[1] > missing[0])
            halves[half].append(root)
            missing[half] += size
        return top, *halves


def checked_labels(graph: PoseGraph, labels: ArrayLike) -> Ids:
    """Return the part of each node as it was given, (n,), checked."""
    given = np.asarray(labels)
    if given.shape != (len(graph),) or given.dtype.kind not in "iu":
        raise PartitionError(
            f"labels must be {len(graph)} integers, the part of each node in the order of "
            f"graph.ids; got {given.dtype} of shape {given.shape}"
        )
    if given.min() < 0:
        node = graph.ids[int(np.argmin(given))]
        raise PartitionError(f"parts are numbered from 0; node {node} has {given.min()}")
    return given.astype(np.int64)


def given_labels(graph: PoseGraph, labels: Ids) -> Ids:
    """Return the parts of nodes, (n,), numbered anew; -1 for nodes that are not optimized."""
    # Numbers that no node has are left out.
    _, numbered = np.unique(labels, return_inverse=True)
    numbered = numbered.astype(np.int64)
    free = np.zeros(len(graph), np.bool_)
    free[graph.structure.free] = True
    numbered[~free] = -1
    used, again = np.unique(numbered, return_inverse=True)
    return again - 1 if used[0] < 0 else again
