"""How well closures agree with a map, and with each other."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from masat import _core, lie
from masat.arrays import Floats, Ids
from masat.covariance import change_of_frame, relative_covariances
from masat.graph import PoseGraph
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


def predict(
    closures: Closures,
    graph: PoseGraph,
    chosen: Ids,
    equations: _core.NormalEquations | None = None,
) -> Prediction:
    """Predict chosen closures from the map of the trusted edges and the kept closures.

    Parameters
    ----------
    closures : Closures
        The closures.
    graph : PoseGraph
        The trusted edges and the closures that are kept, at their minimum.
    chosen : ndarray of int, (k,)
        Indices of the closures to predict, best of those not kept.
    equations : NormalEquations, optional
        Those of the graph, to be used again.

    Returns
    -------
    Prediction
    """
    pairs = closures.graph.edges[closures.edges[chosen]]
    covariance = relative_covariances(graph, pairs, warn=False, equations=equations)
    return _compared(closures, graph, chosen, covariance)


def predict_by_odometry(closures: Closures, graph: PoseGraph, chosen: Ids) -> Prediction:
    """Predict chosen closures from the trusted edges alone, without a closure.

    Where the trusted edges are odometry, relative covariances add up along it: those of 1, 2, 4, 8,
    ... steps are joined to that of each closure. The system of a long chain would cost more.
    """
    trusted = np.flatnonzero(closures.trusted)
    ends = closures.graph.edge_indices[trusted]
    lower = ends.min(axis=1)
    order = np.argsort(lower, kind="stable")
    n = len(closures.graph)
    chain = len(trusted) == n - 1 and bool((np.abs(np.diff(ends, axis=1)) == 1).all())
    if not (chain and (lower[order] == np.arange(n - 1)).all()):
        return predict(closures, graph, chosen)
    poses = graph.poses
    assert poses is not None
    backward = (ends[:, 0] > ends[:, 1])[order]
    step = np.linalg.inv(closures.graph.information[trusted[order]]).astype(np.float64)
    seen = lie.between(poses[1:], poses[:-1])
    step[backward] = _carried(step[backward], seen[backward])
    a, b = closures.ends[chosen].T
    at, left = a.copy(), b - a
    total = np.zeros((len(chosen), *step.shape[1:]))
    length = 1
    while left.any():
        odd = np.flatnonzero(left % 2)
        ahead = at[odd] + length
        total[odd] = _carried(total[odd], lie.between(poses[ahead], poses[at[odd]]))
        total[odd] += step[at[odd]]
        at[odd] = ahead
        left //= 2
        middle, far = np.arange(length, n - length), np.arange(2 * length, n)
        step = _carried(step[: len(far)], lie.between(poses[far], poses[middle])) + step[middle]
        length *= 2
    # They belong to the later node, the measurement's covariance to the second one.
    reverse = closures.reversed[chosen]
    total[reverse] = _carried(total[reverse], lie.between(poses[a[reverse]], poses[b[reverse]]))
    return _compared(closures, graph, chosen, total)


def _carried(covariance: Floats, seen: Floats) -> Floats:
    """Return covariances of steps of poses as seen from others, at which they are `seen`."""
    turn = change_of_frame(seen)
    carried: Floats = turn @ covariance @ turn.swapaxes(-1, -2)
    return carried


def _compared(closures: Closures, graph: PoseGraph, chosen: Ids, covariance: Floats) -> Prediction:
    """Compare measurements with the map, given the covariances of its relative poses."""
    poses = graph.poses
    assert poses is not None
    e = _residuals(closures, poses, chosen)
    turn = slope(e)
    joint = turn @ covariance @ turn.transpose(0, 2, 1) + closures.covariance[chosen]
    solved = np.linalg.solve(joint, e[..., None])[..., 0]
    distance = np.einsum("ki,ki->k", e, solved)
    log_likelihood = -(distance + np.linalg.slogdet(2 * np.pi * joint)[1]) / 2
    return Prediction(distance, log_likelihood + _log_volume(poses))


def _residuals(closures: Closures, poses: Floats, chosen: Ids) -> Floats:
    edges = closures.edges[chosen]
    i, j = closures.graph.edge_indices[edges].T
    return lie.local(closures.graph.measurements[edges], lie.between(poses[i], poses[j]))


def _log_volume(poses: Floats) -> float:
    """Return the logarithm of the volume of the residuals that a false closure may have."""
    d = 2 if poses.shape[1] == 3 else 3
    extent = np.maximum(np.ptp(poses[:, :d], axis=0), 1.0)
    return float(np.log(extent).sum() + np.log(2 * np.pi if d == 2 else 4 * np.pi / 3))


def slope(e: Floats) -> Floats:
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


def agreement(closures: Closures, poses: Floats, pairs: Ids) -> Floats:
    """Return how well pairs of closures of one place agree, (p,): about chi2 if both are true.

    Two closures and the trusted edges between their ends make a short cycle, which must close
    within the uncertainty of its edges. Source: Mangelson, Dominic, Eustice, Vasudevan, Pairwise
    consistent measurement set maximization, ICRA 2018, here for closures of one place alone.
    """
    d = closures.graph.dimension
    i, j = pairs.T
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
