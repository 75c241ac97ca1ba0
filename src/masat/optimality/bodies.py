"""Parts of a graph that move as rigid bodies, so that a large change is cheap at first."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from masat import _core, lie
from masat.arrays import Flags, Floats, Ids
from masat.assembly import AssembledGraph
from masat.graph import PoseGraph


class Bodies(NamedTuple):
    """The rigid bodies of a graph.

    Attributes
    ----------
    graph : PoseGraph
        The graph of the bodies, b of them, at their poses: those of one node of each. Its edges are
        those between two bodies, and its chi2 is theirs.
    first : ndarray of int, (b,)
        Index of that node, in the whole graph.
    body : ndarray of int, (n,)
        The body of each node.
    within : ndarray, (n, 3) or (n, 7)
        The pose of each node in its body.
    """

    graph: PoseGraph
    first: Ids
    body: Ids
    within: Floats

    def moved(self, poses: Floats) -> Floats:
        """Return the poses of the bodies, (b, 3) or (b, 7), rotated as their nodes are on average.

        Parameters
        ----------
        poses : ndarray, (n, 3) or (n, 7)
            Poses of all nodes. Their positions do not count.
        """
        d, count = self.graph.dimension, len(self.first)
        assert self.graph.poses is not None
        here = lie.compose(self.graph.poses[self.body], self.within)
        turns = lie.to_matrices(lie.compose(poses, lie.inverse(here)))[:, :d, :d].reshape(-1, d * d)
        sums = np.column_stack([np.bincount(self.body, column, count) for column in turns.T])
        mean = _core.nearest_rotations(np.ascontiguousarray(sums.reshape(-1, d, d)))
        out = self.graph.poses.copy()
        free = np.setdiff1d(np.arange(count), self.graph.index(self.graph.fixed))
        out[free] = lie.compose(mean[free], out[free])
        return out

    def expanded(self, poses: Floats) -> Floats:
        """Return the poses of all nodes, (n, 3) or (n, 7), from those of the bodies."""
        return lie.compose(poses[self.body], self.within)


def rigid_bodies(graph: PoseGraph, stiff: Flags) -> Bodies:
    """Return the bodies into which some edges join nodes.

    Parameters
    ----------
    graph : PoseGraph
        A graph with poses.
    stiff : ndarray of bool, (m,)
        The edges that keep their nodes together.
    """
    assert graph.poses is not None
    ends = np.ascontiguousarray(graph.edge_indices[stiff])
    body = _core.Topology(len(graph.ids), ends).components().astype(np.int64)
    first = np.unique(body, return_index=True)[1]
    fixed = graph.index(graph.gauge)
    first[body[fixed]] = fixed
    within = lie.between(graph.poses[first[body]], graph.poses)
    i, j = graph.edge_indices.T
    between = np.flatnonzero(body[i] != body[j])
    i, j, offsets = i[between], j[between], graph.sensor_offsets
    sensors = within[j] if offsets is None else lie.compose(within[j], offsets[between])
    bodies = AssembledGraph(
        ids=np.arange(len(first), dtype=np.int64),
        poses=graph.poses[first],
        edges=np.column_stack([body[i], body[j]]),
        measurements=lie.compose(within[i], graph.measurements[between]),
        information=np.ascontiguousarray(graph.information[between]),
        fixed=np.unique(body[fixed]),
        offsets=sensors,
    )
    return Bodies(bodies, first, body, within)
