"""Residuals of the edges, and what edges, priors and observations add to chi2."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from masat import _core, lie
from masat.arrays import Floats
from masat.errors import GraphError

if TYPE_CHECKING:
    from masat.graph import PoseGraph


def residuals(graph: PoseGraph, poses: Floats | None = None) -> Floats:
    """Return the residual e of each edge, the step from its measurement to the poses.

    Parameters
    ----------
    graph : PoseGraph
        The graph.
    poses : ndarray, (n, 3) or (n, 7), optional
        Poses in the order of `graph.ids`. Default: those of the graph.

    Returns
    -------
    ndarray, (m, 3) or (m, 6)
        z^-1 (a^-1 b) as x, y, theta, or as translation and vector part of the quaternion (qw >= 0),
        as in g2o: meters, radians in 2D, the sine of half the angle in 3D.
    """
    return _core.residuals(
        graph.topology, graph.measurements, _poses(graph, poses), graph.sensor_offsets
    )


def chi2_per_edge(graph: PoseGraph, poses: Floats | None = None) -> Floats:
    """Return e' W e of each edge, (m,), without a factor 1/2; parameters as in `residuals`."""
    return _core.chi2_per_edge(
        graph.topology,
        graph.measurements,
        graph.information,
        _poses(graph, poses),
        graph.sensor_offsets,
    )


def chi2_per_prior(graph: PoseGraph) -> Floats:
    """Return e' W e of each prior at the graph's poses and points, (p,)."""
    priors = graph.priors
    if priors is None:
        return np.empty(0)
    at = np.empty((len(priors), graph.measurements.shape[1]))
    on_point = np.isin(priors.ids, graph.point_ids)
    at[~on_point] = _poses(graph, None)[graph.index(priors.ids[~on_point])]
    if on_point.any():
        assert graph.landmarks is not None
        rows = np.searchsorted(graph.landmarks.ids, priors.ids[on_point])
        at[on_point] = as_poses(_points(graph)[rows])
    if priors.offsets is not None:
        at = lie.compose(at, priors.offsets)
    e = lie.local(priors.measurements, at)
    return np.asarray(np.einsum("ki,kij,kj->k", e, priors.information, e))


def chi2_per_observation(graph: PoseGraph) -> Floats:
    """Return e' W e of each observation of a landmark, (l,)."""
    seen = graph.landmarks
    if seen is None:
        return np.empty(0)
    poses = _poses(graph, None)[graph.index(seen.observations[:, 0])]
    points = _points(graph)[np.searchsorted(seen.ids, seen.observations[:, 1])]
    d = graph.dimension
    e = lie.between(poses, as_poses(points))[:, :d] - seen.measurements
    return np.asarray(np.einsum("ki,kij,kj->k", e, seen.information, e))


def as_poses(points: Floats) -> Floats:
    """Return points, (k, 2) or (k, 3), as poses without rotation."""
    d = points.shape[1]
    poses = np.tile(lie.identity(d), (len(points), 1))
    poses[:, :d] = points
    return poses


def _points(graph: PoseGraph) -> Floats:
    if graph.points is None:
        raise GraphError("the landmarks have no positions: solve the graph, or give some")
    return graph.points


def _poses(graph: PoseGraph, poses: Floats | None) -> Floats:
    chosen = graph.poses if poses is None else poses
    if chosen is None:
        raise GraphError("the graph has no poses: give it some with masat.initialize")
    return chosen
