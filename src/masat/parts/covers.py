"""The fewest nodes that touch all edges between two sides."""

from __future__ import annotations

import numpy as np

from masat.arrays import Ids


def smallest_cover(left: Ids, right: Ids) -> Ids:
    """Return a smallest set of nodes that holds an end of each edge, ascending.

    By the theorem of König, from a largest matching of the two sides: Hopcroft and Karp, An n^5/2
    algorithm for maximum matchings in bipartite graphs, 1973.

    Parameters
    ----------
    left, right : ndarray of int64, (k,)
        The two nodes of each edge. No node is on both sides.
    """
    lefts, a = np.unique(left, return_inverse=True)
    rights, b = np.unique(right, return_inverse=True)
    neighbors: list[list[int]] = [[] for _ in lefts]
    for i, j in np.unique(np.stack([a, b], 1), axis=0).tolist():
        neighbors[i].append(j)
    of_left, of_right = [-1] * len(lefts), [-1] * len(rights)
    # A matching that is nearly the largest, at once.
    for i, own in enumerate(neighbors):
        for j in own:
            if of_right[j] < 0:
                of_left[i], of_right[j] = j, i
                break
    while True:
        depth = _depths(neighbors, of_left, of_right)
        seen = [False] * len(lefts)
        found = [_augment(i, neighbors, of_left, of_right, depth, seen) for i in _free(of_left)]
        if not any(found):
            break
    uncovered = np.array(depth) >= 0
    met = np.zeros(len(rights), np.bool_)
    for i in np.flatnonzero(uncovered):
        met[neighbors[i]] = True
    return np.sort(np.concatenate([lefts[~uncovered], rights[met]]))


def _free(of_left: list[int]) -> list[int]:
    return [i for i, j in enumerate(of_left) if j < 0]


def _depths(neighbors: list[list[int]], of_left: list[int], of_right: list[int]) -> list[int]:
    """Return the steps of alternating paths from the free nodes on the left; -1 beyond."""
    level = _free(of_left)
    depth = [-1] * len(neighbors)
    for i in level:
        depth[i] = 0
    while level:
        below = []
        for i in level:
            for j in neighbors[i]:
                k = of_right[j]
                if k >= 0 and depth[k] < 0:
                    depth[k] = depth[i] + 1
                    below.append(k)
        level = below
    return depth


def _augment(
    root: int,
    neighbors: list[list[int]],
    of_left: list[int],
    of_right: list[int],
    depth: list[int],
    seen: list[bool],
) -> bool:
    """Turn an alternating path from a free node on the left around, if there is one."""
    path = [(root, iter(neighbors[root]))]
    taken: list[int] = []
    while path:
        i, rest = path[-1]
        for j in rest:
            k = of_right[j]
            if k < 0:
                taken.append(j)
                for (node, _), to in zip(path, taken, strict=True):
                    of_left[node], of_right[to] = to, node
                return True
            if depth[k] == depth[i] + 1 and not seen[k]:
                taken.append(j)
                seen[k] = True
                path.append((k, iter(neighbors[k])))
                break
        else:
            path.pop()
            if taken:
                taken.pop()
    return False
