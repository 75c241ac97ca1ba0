"""Loop closures of all worlds: where a track meets itself, and which pairs are measured."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import product

import numpy as np

from masat.arrays import Floats, Ids
from masat.errors import GraphError
from masat.graph import PoseGraph
from masat.lie import between

# The core counts nodes and edges in 32 bits.
MAX_COUNT = 2**31 - 1


class NearPairs:
    """The pairs of poses in the same or in adjacent cells, counted without a list of them.

    A walk that often crosses its own track has far more such pairs than a graph has edges.

    Parameters
    ----------
    cells : ndarray of int64, (n, d)
        Cell of each pose, in temporal order.
    offsets : array_like of int, (k, d)
        Offsets from the cell of the later pose to the cells of the earlier ones.
    gap : int
        Smallest number of steps between the two poses.
    """

    count: int
    """Number of pairs."""

    def __init__(self, cells: Ids, offsets: Ids, gap: int = 2) -> None:
        nodes = len(cells)
        spans = np.ptp(cells, axis=0) + 3  # a margin, so that no offset wraps around
        weights = np.concatenate([np.cumprod(spans[::-1])[-2::-1], [1]])
        keys = (cells - cells.min(axis=0) + 1) @ weights
        # Sorted by cell, then by time, so that the earlier poses of a cell are a range.
        self._keys = np.sort(keys * nodes + np.arange(nodes))
        wanted = (keys[:, None] + offsets @ weights) * nodes
        until = np.maximum(np.arange(nodes) - gap + 1, 0)
        self._first = np.searchsorted(self._keys, wanted.ravel())
        last = np.searchsorted(self._keys, (wanted + until[:, None]).ravel())
        self._ends = np.cumsum(last - self._first)
        self._nodes, self._offsets = nodes, len(offsets)
        self.count = int(self._ends[-1])

    def pairs(self, which: Ids) -> Ids:
        """Return the pairs (earlier, later), (c, 2), with the given numbers in [0, count)."""
        slot = np.searchsorted(self._ends, which, "right")
        # A slot is a later pose and an offset; the last pair of a slot is the last of its range.
        begins = np.concatenate([[0], self._ends[:-1]])[slot]
        earlier = self._keys[self._first[slot] + which - begins] % self._nodes
        return np.column_stack([earlier, slot // self._offsets])


def on_lattice(cells: Ids) -> NearPairs:
    """Return the pairs of cells, (n, d), at most one unit apart on a lattice."""
    unit = np.eye(cells.shape[1], dtype=np.int64)
    return NearPairs(cells, np.concatenate([0 * unit[:1], unit, -unit]))


def within(points: Floats, reach: float, gap: int) -> Ids:
    """Return the pairs (earlier, later), (c, 2), of points (n, d) at most `reach` meters apart."""
    cells = np.floor(points / reach).astype(np.int64)
    near = NearPairs(cells, np.array(list(product((-1, 0, 1), repeat=points.shape[1]))), gap)
    pairs = near.pairs(np.arange(near.count))
    apart = points[pairs[:, 0]] - points[pairs[:, 1]]
    found: Ids = pairs[np.einsum("ij,ij->i", apart, apart) <= reach**2]
    return found


def lagged(nodes: int, lags: Iterable[int]) -> Ids:
    """Return the pairs (k, k + lag), (c, 2), for each lag of at least two steps."""
    starts = [(np.arange(nodes - lag), lag) for lag in sorted(set(lags)) if 2 <= lag < nodes]
    pairs = [np.column_stack([start, start + lag]) for start, lag in starts]
    return np.concatenate([np.empty((0, 2), np.int64), *pairs])


def check_integers(**values: object) -> None:
    """Refuse values that are not integers."""
    for name, value in values.items():
        if not isinstance(value, (int, np.integer)) or isinstance(value, bool):
            raise GraphError(f"{name} must be an integer, got {value!r}")


def check_size(nodes: int, edges: int | None) -> None:
    """Refuse a number of nodes or edges that no walk can have."""
    check_integers(nodes=nodes, edges=nodes if edges is None else edges)
    if nodes < 2 or (edges is not None and edges < nodes - 1):
        given = f"{nodes} nodes" + ("" if edges is None else f" and {edges} edges")
        raise GraphError(
            "a walk has at least two nodes, and an edge between each node and the next; got "
            f"{given}"
        )
    if max(nodes, edges or 0) > MAX_COUNT:
        raise GraphError(f"a world has at most {MAX_COUNT} nodes and edges")


def check_seed(seed: int) -> None:
    """Refuse a seed that the generator of random numbers does not take."""
    check_integers(seed=seed)
    if seed < 0:
        raise GraphError(f"a seed must not be negative, got {seed}")


def generator(seed: int) -> np.random.Generator:
    """Return the random numbers of a world, which differ from those of noise of the same seed."""
    check_seed(seed)
    return np.random.default_rng([seed, 1])


def draw(
    offered: int, nodes: int, edges: int | None, usual: int, random: np.random.Generator
) -> Ids:
    """Draw the loop closures that are measured from those that a walk offers.

    Parameters
    ----------
    offered : int
        Number of loop closures to draw from.
    nodes : int
        Number of nodes of the graph.
    edges : int or None
        Number of edges of the graph. None: the usual number, or as many as the walk offers.
    usual : int
        Usual number of edges of such a world.
    random : Generator
        Generator that draws the loop closures.

    Returns
    -------
    ndarray of int64, (c,)
        Numbers in [0, offered), ascending.
    """
    wanted = (usual if edges is None else edges) - (nodes - 1)
    if edges is None:
        wanted = max(0, min(wanted, offered))
    if wanted > offered:
        raise GraphError(
            f"the walk offers {offered} loop closures, but {edges} edges need {wanted}; ask for "
            "fewer edges, or for more nodes"
        )
    return np.sort(random.choice(offered, wanted, replace=False, shuffle=False))


def in_time(nodes: int, loops: Ids) -> Ids:
    """Return odometry and loop closures, (m, 2), in the order of their later poses."""
    chain = np.column_stack([np.arange(nodes - 1), np.arange(1, nodes)])
    pairs = np.concatenate([chain, loops])
    return pairs[np.lexsort((pairs[:, 0] != pairs[:, 1] - 1, pairs[:, 1]))]


def truth(poses: Floats, loops: Ids) -> PoseGraph:
    """Return the graph of exact measurements between poses, (n, 3) or (n, 7)."""
    pairs = in_time(len(poses), loops)
    exact = between(poses[pairs[:, 0]], poses[pairs[:, 1]])
    return PoseGraph.from_arrays(pairs, exact, poses=poses, ids=np.arange(len(poses)))
