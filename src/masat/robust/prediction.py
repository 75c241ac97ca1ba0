"""How well closures agree with a map, and with each other."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from masat import _core, lie
from masat.arrays import Floats, Ids
from masat.covariance import relative_covariances
from masat.graph import PoseGraph
from masat.neighbors import cycle_distances, variance_along
from masat.redundancy import step_of_residual
from masat.robust.closures import Closures
from masat.robust.odometry_sums import carried, odometry_sums

_EPSILON = float(np.finfo(np.float64).eps)
# Rounding of a sum of covariances that is allowed, against the covariance of a measurement.
_MAX_ROUNDING = 1e-3


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

    Where the trusted edges are odometry, covariances add up along it (`odometry_sums`). The system
    of a long chain would cost more. Closures between parts that nothing joins are NaN.
    """
    poses = graph.poses
    assert poses is not None
    along = odometry_sums(graph)
    if along is None:
        return predict(closures, graph, chosen)
    a, b = closures.ends[chosen].T
    total, apart = along.between(a, b)
    largest = np.einsum("kii->k", along.sums)[np.concatenate([a, b])].max(initial=0.0)
    smallest = np.einsum("kii->k", closures.covariance[chosen]).min(initial=np.inf)
    if _EPSILON * largest > _MAX_ROUNDING * smallest:
        return predict(closures, graph, chosen)
    # They belong to the second node of the closure.
    second = np.where(closures.reversed[chosen], a, b)
    total = carried(total, lie.between(poses[second], along.center))
    found = _compared(closures, graph, chosen, total)
    found.distance[apart] = found.log_ratio[apart] = np.nan
    return found


def _compared(closures: Closures, graph: PoseGraph, chosen: Ids, covariance: Floats) -> Prediction:
    """Compare measurements with the map, given the covariances of its relative poses."""
    poses = graph.poses
    assert poses is not None
    e = _residuals(closures, poses, chosen)
    turn = step_of_residual(e)
    joint = turn @ covariance @ turn.transpose(0, 2, 1) + closures.covariance[chosen]
    solved = np.linalg.solve(joint, e[..., None])[..., 0]
    distance = np.einsum("ki,ki->k", e, solved)
    log_likelihood = -(distance + np.linalg.slogdet(2 * np.pi * joint)[1]) / 2
    return Prediction(distance, log_likelihood + log_volume(poses))


def _residuals(closures: Closures, poses: Floats, chosen: Ids) -> Floats:
    edges = closures.edges[chosen]
    i, j = closures.graph.edge_indices[edges].T
    return lie.local(closures.graph.measurements[edges], lie.between(poses[i], poses[j]))


def log_volume(poses: Floats) -> float:
    """Return the logarithm of the volume of the residuals that a false closure may have."""
    d = 2 if poses.shape[1] == 3 else 3
    extent = np.maximum(np.ptp(poses[:, :d], axis=0), 1.0)
    return float(np.log(extent).sum() + np.log(2 * np.pi if d == 2 else 4 * np.pi / 3))


def agreement(closures: Closures, poses: Floats, pairs: Ids) -> Floats:
    """Return how well pairs of closures of one place agree, (p,): about chi2 if both are true.

    Two closures and the trusted edges between their ends make a short cycle, which must close
    within the uncertainty of its edges. Source: Mangelson, Dominic, Eustice, Vasudevan, Pairwise
    consistent measurement set maximization, ICRA 2018, here for closures of one place alone.
    """
    own = np.einsum("kii->ki", closures.covariance)
    along = variance_along(closures.graph, closures.trusted)
    return cycle_distances(pairs, closures.ends, closures.measurements, own, poses, along)
