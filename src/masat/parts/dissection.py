"""The separators between the parts of a graph, and their tree."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from masat.arrays import Flags, Ids, Indices
from masat.errors import PartitionError
from masat.graph import PoseGraph
from masat.parts.covers import smallest_cover


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


def metis_labels(graph: PoseGraph, parts: int) -> Ids:
    """Return the part of each node by recursive bisection, (n,); -1 for those not optimized.

    Source: Karypis and Kumar, A fast and high quality multilevel scheme for partitioning irregular
    graphs, 1998.
    """
    free = _free(graph)
    count = int(np.count_nonzero(free))
    if not 1 <= parts <= count:
        raise PartitionError(
            "the number of parts must be from 1 to the number of nodes that are optimized, "
            f"{count}; got {parts}"
        )
    labels = np.where(free, 0, -1).astype(np.int64)
    if parts == 1:
        return labels
    try:
        import pymetis
    except ImportError:
        raise PartitionError(
            "cutting a graph into parts needs the package pymetis; install it, or give the part "
            "of each node"
        ) from None
    start, neighbors = _adjacency(graph, free)
    _, found = pymetis.part_graph(parts, pymetis.CSRAdjacency(start, neighbors), recursive=True)
    labels[free] = found
    return labels


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
    numbered[~_free(graph)] = -1
    used, again = np.unique(numbered, return_inverse=True)
    return again - 1 if used[0] < 0 else again


def _free(graph: PoseGraph) -> Flags:
    free = np.zeros(len(graph), np.bool_)
    free[graph.structure.free] = True
    return free


def _adjacency(graph: PoseGraph, free: Flags) -> tuple[Ids, Indices]:
    """Return the neighbors of the free nodes as compressed rows."""
    count = int(np.count_nonzero(free))
    number = np.cumsum(free) - 1
    pairs = graph.edge_indices[free[graph.edge_indices].all(axis=1)]
    pairs = number[pairs]
    pairs = pairs[pairs[:, 0] != pairs[:, 1]]
    keys = np.unique(
        np.concatenate([pairs[:, 0] * count + pairs[:, 1], pairs[:, 1] * count + pairs[:, 0]])
    )
    rows, neighbors = np.divmod(keys, count)
    start = np.concatenate([[0], np.cumsum(np.bincount(rows, minlength=count))])
    return start.astype(np.int64), neighbors.astype(np.int32)
