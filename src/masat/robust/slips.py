"""Trusted edges that all closures across them contradict: a slipped wheel, a lost track."""

from __future__ import annotations

import numpy as np

from masat import lie
from masat.arrays import Ids
from masat.robust.closures import Closures
from masat.robust.growth import Growth

# Clusters of closures that have to contradict an edge; one more if of so many false ones some may
# agree by chance.
_MIN_CLUSTERS, _MANY = 2, 50
# Fraction of the clusters across an edge that have to agree how wrong it is.
_MIN_AGREEING = 0.5
# Two corrections are the same if they differ by less than this fraction of them, and this angle.
_SAME, _SAME_ANGLE = 0.05, 0.02


def suspected_slip(closures: Closures, growth: Growth) -> int | None:
    """Return the index of a trusted edge that may be wrong, or None.

    Across it, which is from a node before to a node behind, no closure is kept, and more clusters
    are rejected than across any other edge. Nothing tells it from the
    neighbors that the same closures span; the one in the middle is taken.

    Parameters
    ----------
    closures : Closures
        The closures.
    growth : Growth
        A map that no longer grows.
    """
    graph = closures.graph
    n = len(graph)
    ends = graph.edge_indices[closures.trusted].astype(np.int64)
    odometry = np.abs(np.diff(ends, axis=1)[:, 0]) == 1
    steps = np.full(n, -1, np.int64)
    steps[ends[odometry].min(axis=1)] = np.flatnonzero(closures.trusted)[odometry]
    # Other trusted edges and kept closures confirm the steps that they span.
    confirming = np.concatenate([np.sort(ends[~odometry], axis=1), closures.ends[growth.kept]])
    confirmed = _spans(confirming, n) > 0
    open_steps = np.concatenate([[0], np.cumsum(~confirmed & (steps >= 0))])
    across = open_steps[closures.ends[:, 1]] > open_steps[closures.ends[:, 0]]
    # One closure represents each group of more than one.
    group = growth.representative
    rejected = np.bincount(group[~growth.kept & growth.supported], minlength=len(closures)) > 1
    judged = np.flatnonzero(rejected & across)
    clusters = len(np.unique(growth.runs[rejected]))
    needed = _MIN_CLUSTERS if clusters <= _MANY else _MIN_CLUSTERS + 1
    if len(np.unique(growth.runs[judged])) < needed:
        return None
    spans = _spans(_one_of_each(closures, growth, judged), n)
    against = _spans(_one_of_each(closures, growth, _agreeing(closures, growth, judged)), n)
    against[confirmed | (steps < 0) | (against < _MIN_AGREEING * spans)] = 0
    most = int(against.max(initial=0))
    if most < needed:
        return None
    places = np.flatnonzero(against == most)
    return int(steps[places[len(places) // 2]])


def _one_of_each(closures: Closures, growth: Growth, chosen: Ids) -> Ids:
    """Return the ends of one closure of each cluster: those of one place have one cause."""
    _, first = np.unique(growth.runs[chosen], return_index=True)
    ends: Ids = closures.ends[chosen[first]]
    return ends


def _agreeing(closures: Closures, growth: Growth, chosen: Ids) -> Ids:
    """Return those closures that one of another cluster confirms: both would move as much.

    A closure (a, b) fits if all that comes after the slip is moved by a z b^-1, in the map's frame.
    """
    d, poses, cluster = closures.graph.dimension, growth.poses, growth.runs[chosen]
    a, b = closures.ends[chosen].T
    moved = lie.compose(poses[a], closures.measurements[chosen])
    shift = lie.compose(moved, lie.inverse(poses[b]))
    found = np.zeros(len(chosen), np.bool_)
    for k in range(len(chosen)):
        there = lie.compose(shift, poses[b[k]])
        off = np.linalg.norm(there[:, :d] - moved[k, :d], axis=1)
        turn = np.linalg.norm(lie.local(moved[k], there)[:, d:], axis=1)
        far = np.linalg.norm(moved[k, :d] - poses[b[k], :d])
        turned = np.linalg.norm(lie.local(poses[b[k]], moved[k])[d:])
        same = (off < _SAME * far) & (turn < _SAME * turned + _SAME_ANGLE)
        found[k] = (same & (cluster != cluster[k])).any()
    agreeing: Ids = chosen[found]
    return agreeing


def _spans(ends: Ids, n: int) -> Ids:
    """Return how many pairs (a, b), a < b, span the step from each node to the next, (n,)."""
    change = np.bincount(ends[:, 0], minlength=n) - np.bincount(ends[:, 1], minlength=n)
    spans: Ids = np.cumsum(change)
    return spans
