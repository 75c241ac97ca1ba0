"""The loop closures of a graph, and the clusters that they form."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from masat import _core, lie
from masat.arrays import Flags, Floats, Ids, Indices
from masat.chain import odometry_edges
from masat.errors import OptimizationError
from masat.graph import PoseGraph

# Closures whose ends are both at most this many nodes apart are of one place.
REACH = 10
# So few closures or nodes are few.
_FEW = 200


class Closures:
    """The edges of a graph that may be false, against those that are trusted.

    Parameters
    ----------
    graph : PoseGraph
        The graph.
    trusted : array_like of bool, (m,), optional
        The edges to trust. Default: odometry, the first edge of each pair of consecutive ids.
    threads : int, optional
        Threads that compute. Default: as many as pay.

    Raises
    ------
    OptimizationError
        If the mask has another shape, or no edge is trusted.
    """

    def __init__(
        self, graph: PoseGraph, trusted: ArrayLike | None = None, threads: int | None = None
    ) -> None:
        mask = checked_trusted(graph, odometry_edges(graph) if trusted is None else trusted)
        if not mask.any():
            raise OptimizationError(
                "no edge is trusted: closures can be judged only against others, such as odometry "
                "between consecutive ids; name the trusted edges"
            )
        self.graph = graph
        self.threads = threads
        self.trusted: Flags = mask
        self.edges: Ids = np.flatnonzero(~mask)
        self.covariance: Floats = np.linalg.inv(graph.information[self.edges]).astype(np.float64)
        ends = graph.edge_indices[self.edges].astype(np.int64)
        self.reversed: Flags = ends[:, 0] > ends[:, 1]
        # Ends in the order of the ids, so that closures of one place can be compared.
        self.ends: Ids = np.sort(ends, axis=1)
        measured = graph.measurements[self.edges].copy()
        measured[self.reversed] = lie.inverse(measured[self.reversed])
        self.measurements: Floats = measured

    def __len__(self) -> int:
        return len(self.edges)

    @property
    def few(self) -> bool:
        """Whether each closure matters, or the graph is small, so that more trials are made."""
        return len(self) <= _FEW or len(self.graph) <= _FEW

    def kept_edges(self, kept: Flags) -> Flags:
        """Return the trusted edges and the kept closures, (m,)."""
        out = self.trusted.copy()
        out[self.edges[kept]] = True
        return out

    def graph_with(self, kept: Flags, poses: Floats) -> PoseGraph:
        """Return the graph without the closures that are not kept, at some poses."""
        return self.graph.without_edges(~self.kept_edges(kept)).with_poses(poses)

    @cached_property
    def pairs(self) -> Ids:
        """Pairs of closures of one place, (p, 2)."""
        return self._pairs(len(self))

    @cached_property
    def some_pairs(self) -> Ids:
        """One or two pairs of one place for each closure that has any, (p, 2)."""
        return self._pairs(3)

    def _pairs(self, lags: int) -> Ids:
        """Return the pairs that are less than so many lags apart in the order of the ends."""
        order = np.lexsort((self.ends[:, 1], self.ends[:, 0]))
        first, second = self.ends[order].T
        found = [np.empty((0, 2), np.int64)]
        for lag in range(1, min(lags, len(order))):
            near = first[lag:] - first[:-lag] <= REACH
            if not near.any():
                break
            near &= np.abs(second[lag:] - second[:-lag]) <= REACH
            k = np.flatnonzero(near)
            found.append(np.column_stack([order[k], order[k + lag]]))
        return np.concatenate(found)

    @cached_property
    def clusters(self) -> Indices:
        """Cluster of each closure: those connected by pairs of one place, numbered from 0."""
        return connected(len(self), self.pairs)


def checked_trusted(graph: PoseGraph, trusted: ArrayLike) -> Flags:
    """Return a mask of trusted edges, if it has a boolean for each edge."""
    mask = np.asarray(trusted)
    if mask.shape != (len(graph.edges),) or mask.dtype != np.bool_:
        raise OptimizationError(
            f"trusted must have a boolean for each of the {len(graph.edges)} edges, got "
            f"{mask.dtype} of shape {mask.shape}"
        )
    return mask


def connected(count: int, pairs: Ids) -> Indices:
    """Return the connected component of each of so many things, by pairs that belong together."""
    if count == 0:
        return np.empty(0, np.int32)
    return _core.Topology(count, np.ascontiguousarray(pairs.astype(np.int32))).components()
