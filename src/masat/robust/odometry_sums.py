"""Covariances of relative poses along odometry: they add up, without a linear system."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from masat import lie
from masat.arrays import Floats, Ids
from masat.covariance import change_of_frame
from masat.graph import PoseGraph


@dataclass(frozen=True)
class OdometrySums:
    """Sums of covariances along runs of odometry, and along the edges that join the runs.

    A run is a maximal sequence of consecutive nodes. All covariances are those of steps of a pose
    in the midst of the map.

    Attributes
    ----------
    center : ndarray, (3,) or (7,)
        The pose in the midst.
    sums : ndarray, (n, dof, dof)
        From the first node of its run to each node.
    run : ndarray of int64, (n,)
        The run of each node.
    tree : ndarray of int64, (r,)
        The tree of runs that each run belongs to.
    depth : ndarray of int64, (r,)
        How many edges lie between a run and the root of its tree.
    entry, exit : ndarray of int64, (r,)
        The ends of the edge to the run nearer to the root: the own one and the other one.
    joint : ndarray, (r, dof, dof)
        The covariance of that edge.
    """

    center: Floats
    sums: Floats
    run: Ids
    tree: Ids
    depth: Ids
    entry: Ids
    exit: Ids
    joint: Floats

    def between(self, a: Ids, b: Ids) -> tuple[Floats, Ids]:
        """Return the sums of covariances between nodes, (k, dof, dof), and which have none."""
        apart = np.flatnonzero(self.tree[self.run[a]] != self.tree[self.run[b]])
        at = [a.copy(), b.copy()]
        at[1][apart] = at[0][apart]
        total = np.zeros((len(a), *self.sums.shape[1:]))
        while True:
            runs = [self.run[ends] for ends in at]
            different = runs[0] != runs[1]
            if not different.any():
                break
            # The deeper end moves on, the second one if both are as deep.
            second = self.depth[runs[1]] >= self.depth[runs[0]]
            for ends, own, moves in zip(at, runs, (~second, second), strict=True):
                k = np.flatnonzero(different & moves)
                total[k] += self._within(ends[k], self.entry[own[k]]) + self.joint[own[k]]
                ends[k] = self.exit[own[k]]
        return total + self._within(*at), apart

    def _within(self, a: Ids, b: Ids) -> Floats:
        return self.sums[np.maximum(a, b)] - self.sums[np.minimum(a, b)]


def odometry_sums(graph: PoseGraph) -> OdometrySums | None:
    """Return the sums along the edges of a graph of odometry, or None if it has cycles.

    Parameters
    ----------
    graph : PoseGraph
        The trusted edges alone, at their poses.
    """
    poses = graph.poses
    assert poses is not None
    n, d, dof = len(graph), graph.dimension, graph.dof
    if len(graph.edges) != n - (int(graph.components.max()) + 1) or len(graph.fixed) > 1:
        return None
    ends = graph.edge_indices.astype(np.int64)
    lower = ends.min(axis=1)
    consecutive = np.abs(np.diff(ends, axis=1))[:, 0] == 1
    center = lie.identity(d)
    center[:d] = poses[:, :d].mean(axis=0)
    covariance = carried(
        np.linalg.inv(graph.information).astype(np.float64), lie.between(center, poses[ends[:, 1]])
    )
    steps = np.zeros((n, dof, dof))
    steps[lower[consecutive] + 1] = covariance[consecutive]
    starts = np.ones(n, np.int64)
    starts[lower[consecutive] + 1] = 0
    run = np.cumsum(starts) - 1
    count = int(run[-1]) + 1
    joint = np.zeros((count, dof, dof))
    tree, depth, entry, exit_ = (np.full(count, -1) for _ in range(4))
    joining: dict[int, list[int]] = {}
    for edge in np.flatnonzero(~consecutive).tolist():
        for own in run[ends[edge]].tolist():
            joining.setdefault(own, []).append(edge)
    for root in range(count):
        if tree[root] >= 0:
            continue
        tree[root], depth[root] = root, 0
        waiting = deque([root])
        while waiting:
            near = waiting.popleft()
            for edge in joining.get(near, ()):
                a, b = ends[edge]
                if run[a] != near:
                    a, b = b, a
                far = int(run[b])
                if tree[far] < 0:
                    tree[far], depth[far] = root, depth[near] + 1
                    exit_[far], entry[far], joint[far] = a, b, covariance[edge]
                    waiting.append(far)
    return OdometrySums(center, np.cumsum(steps, axis=0), run, tree, depth, entry, exit_, joint)


def carried(covariance: Floats, seen: Floats) -> Floats:
    """Return covariances of steps of poses as seen from others, at which they are `seen`."""
    turn = change_of_frame(seen)
    out: Floats = turn @ covariance @ turn.swapaxes(-1, -2)
    return out
