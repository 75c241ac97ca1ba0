"""How well closures agree with a map, and with each other."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from masat import _core, lie
from masat.arrays import Flags, Floats, Ids
from masat.covariance import relative_covariances
from masat.residuals import residuals
from masat.robust.closures import Closures


class Prediction(NamedTuple):
    """What a map predicts of closures, (k,) each.

    Attributes
    ----------
    distance : ndarray
        Squared Mahalanobis distance of the measurement from the prediction, with the covariances
        of both.
    log_ratio : ndarray
        Logarithm of the likelihood of the measurement, over that of a false closure, which can be
        anything within the extent of the map.
    """

    distance: Floats
    log_ratio: Floats


def predict(closures: Closures, kept: Flags, poses: Floats, chosen: Ids) -> Prediction:
    """Predict chosen closures from the map of the trusted edges and the kept closures.

    Parameters
    ----------
    closures : Closures
        The closures.
    kept : ndarray of bool, (c,)
        Those that make the map.
    poses : ndarray, (n, 3) or (n, 7)
        The poses of that map.
    chosen : ndarray of int, (k,)
        Indices of the closures to predict, best of those not kept.

    Returns
    -------
    Prediction
    """
    graph, edges = closures.graph, closures.edges[chosen]
    joint = relative_covariances(closures.graph_with(kept, poses), graph.edges[edges], warn=False)
    e = residuals(graph, poses)[edges]
    slope = _slope(e)
    joint = slope @ joint @ slope.transpose(0, 2, 1) + closures.covariance[chosen]
    solved = np.linalg.solve(joint, e[..., None])[..., 0]
    distance = np.einsum("ki,ki->k", e, solved)
    log_likelihood = -(distance + np.linalg.slogdet(2 * np.pi * joint)[1]) / 2
    return Prediction(distance, log_likelihood + _log_volume(poses))


def _log_volume(poses: Floats) -> float:
    """Return the logarithm of the volume of the residuals that a false closure may have."""
    d = 2 if poses.shape[1] == 3 else 3
    extent = np.maximum(np.ptp(poses[:, :d], axis=0), 1.0)
    return float(np.log(extent).sum() + np.log(2 * np.pi if d == 2 else 4 * np.pi / 3))


def _slope(e: Floats) -> Floats:
    """Return the derivative of residuals by a step of the relative pose, (k, dof, dof)."""
    k, dof = e.shape
    slope = np.zeros((k, dof, dof))
    d = 2 if dof == 3 else 3
    pose = np.zeros((k, lie.POSE_SIZE[d]))
    if d == 2:
        pose[:, 2] = e[:, 2]
        slope[:, 2, 2] = 1
    else:
        vector = e[:, 3:]
        w = np.sqrt(np.maximum(1 - np.square(vector).sum(axis=1), 0))
        pose[:, 3:6], pose[:, 6] = vector, w
        slope[:, 3:, 3:] = w[:, None, None] * np.eye(3)
        for i, j, axis in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            slope[:, 3 + i, 3 + j] -= vector[:, axis]
            slope[:, 3 + j, 3 + i] += vector[:, axis]
    slope[:, :d, :d] = _core.rotation_matrices(pose)
    return slope


def agreement(closures: Closures, poses: Floats) -> Floats:
    """Return how well the pairs of closures of one place agree, (p,): about chi2 if both are true.

    Two closures and the trusted edges between their ends make a short cycle, which must close
    within the uncertainty of its edges. Source: Mangelson, Dominic, Eustice, Vasudevan, Pairwise
    consistent measurement set maximization, ICRA 2018, here for closures of one place alone.
    """
    d = closures.graph.dimension
    i, j = closures.pairs.T
    a, b = closures.ends.T
    there = lie.between(poses[a[j]], poses[a[i]])
    back = lie.between(poses[b[i]], poses[b[j]])
    measured = closures.measurements
    e = lie.local(measured[j], lie.compose(lie.compose(there, measured[i]), back))
    own = np.einsum("kii->ki", closures.covariance)
    along = _variance_along(closures)
    variance = own[i] + own[j]
    variance += np.abs(along[a[j]] - along[a[i]]) + np.abs(along[b[j]] - along[b[i]])
    # A rotation moves what is an arm's length away.
    arm = np.sum([np.linalg.norm(p[:, :d], axis=1) for p in (there, back, measured[i])], axis=0)
    variance[:, :d] += (variance[:, d:].max(axis=1, initial=0) * np.square(arm))[:, None]
    distance: Floats = (np.square(e) / variance).sum(axis=1)
    return distance


def _variance_along(closures: Closures) -> Floats:
    """Return the sum of the variances of the trusted edges from the first node on, (n, dof)."""
    graph = closures.graph
    last = graph.edge_indices[closures.trusted].max(axis=1)
    steps = np.zeros((len(graph), graph.dof))
    covariance = np.linalg.inv(graph.information[closures.trusted])
    np.maximum.at(steps, last, np.einsum("kii->ki", covariance))
    total: Floats = np.cumsum(steps, axis=0)
    return total
