"""Parts of a graph that the trusted edges leave unconnected, such as the sessions of a robot."""

from __future__ import annotations

import numpy as np

from masat import lie
from masat.arrays import Floats, Ids, Indices
from masat.initializers import guess_of
from masat.neighbors import cycle_residuals, variance_along
from masat.robust.closures import Closures
from masat.robust.prediction import log_volume

# Closures between two parts that each one is compared with: all of them, or so many spread evenly.
_MAX_COMPARED = 60


def joining_closures(closures: Closures) -> Ids:
    """Return closures that join the parts of the trusted edges, one for each connection.

    Nothing predicts a closure between two parts before another one joins them, but two closures
    between the same parts predict each other. The evidence for a closure is the sum of the
    logarithms of the likelihood ratios with which the others confirm it. The two parts with the
    most evidence join first, by the closure that has it.

    Parameters
    ----------
    closures : Closures
        The closures.

    Returns
    -------
    ndarray of int64
        Indices in `closures.graph.edges`.
    """
    graph = closures.graph
    trusted = graph.without_edges(~closures.trusted)
    labels = trusted.components.copy()
    # Fixed nodes relate the parts that they are in.
    fixed = np.unique(labels[graph.index(graph.fixed)])
    labels[np.isin(labels, fixed)] = fixed[0] if len(fixed) else 0
    i, j = labels[closures.ends].T
    if (i == j).all():
        return np.empty(0, np.int64)
    poses = guess_of(trusted, "odometry").poses
    assert poses is not None
    parts = np.sort(labels[closures.ends], axis=1)
    between = np.flatnonzero(parts[:, 0] != parts[:, 1])
    _, connection = np.unique(parts[between], axis=0, return_inverse=True)
    evidence = _evidence(closures, poses, labels, between, connection.ravel())
    chosen: list[int] = []
    for k in between[np.lexsort((between, -evidence))].tolist():
        a, b = labels[closures.ends[k]]
        if a != b:
            chosen.append(k)
            labels = np.where(labels == b, a, labels)
    return closures.edges[np.array(chosen, np.int64)]


def _evidence(
    closures: Closures, poses: Floats, labels: Indices, between: Ids, connection: Ids
) -> Floats:
    """Return how much closures of the same connection confirm each one, (k,)."""
    # All of them from the part with the smaller label, so that only poses of one part are compared.
    ends, measurements = closures.ends.copy(), closures.measurements.copy()
    swapped = np.diff(labels[ends], axis=1)[:, 0] < 0
    ends[swapped] = ends[swapped, ::-1]
    measurements[swapped] = lie.inverse(measurements[swapped])
    evidence = np.zeros(len(between))
    own = np.einsum("kii->ki", closures.covariance)
    along = variance_along(closures.graph, closures.trusted)
    free = log_volume(poses)
    for k in range(int(connection.max(initial=-1)) + 1):
        members = np.flatnonzero(connection == k)
        others = members[:: -(-len(members) // _MAX_COMPARED)]
        rows = np.stack(np.meshgrid(members, others, indexing="ij"), axis=-1).reshape(-1, 2)
        e, variance = cycle_residuals(between[rows], ends, measurements, own, poses, along)
        cost = (np.square(e) / variance + np.log(2 * np.pi * variance)).sum(axis=1) / 2
        # None confirms itself, and what contradicts may be false.
        ratio = np.where(rows[:, 0] == rows[:, 1], 0, np.maximum(free - cost, 0))
        ratio = ratio.reshape(len(members), len(others)).sum(axis=1)
        evidence[members] = ratio * (len(members) / len(others))
    return evidence
