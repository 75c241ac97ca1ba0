"""Residuals of the edges, and what edges, priors and observations add to chi2."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from masat import _core, lie
from masat.arrays import Flags, Floats, Ids
from masat.errors import GraphError

if TYPE_CHECKING:
    from masat.graph import PoseGraph
    from masat.measurements import Landmarks


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
        graph.topology,
        graph.measurements,
        _poses(graph, poses),
        graph.sensor_offsets,
        graph.range_bearing_edges,
    )


def range_bearing_by_position(graph: PoseGraph, edges: Ids) -> Floats:
    """Return the derivatives of ranges and bearings by positions in the frames measured.

    Parameters
    ----------
    graph : PoseGraph
        A graph with poses.
    edges : ndarray of int, (k,)
        Indices of edges that measure range and bearing.

    Returns
    -------
    ndarray, (k, d, d)
    """
    poses, d = _poses(graph, None), graph.dimension
    i, j = graph.edge_indices[edges].T
    z = graph.measurements[edges]
    ranges = np.sqrt(np.square(z[:, :d]).sum(axis=1))
    z[:, :d] = 0
    ahead = lie.between(lie.compose(poses[i], z), poses[j])[:, :d]
    return _core.range_bearing_errors(np.ascontiguousarray(ahead), ranges)[1]


def chi2_per_edge(graph: PoseGraph, poses: Floats | None = None) -> Floats:
    """Return e' W e of each edge, (m,), without a factor 1/2; parameters as in `residuals`."""
    return _core.chi2_per_edge(
        graph.topology,
        graph.measurements,
        graph.information,
        _poses(graph, poses),
        graph.sensor_offsets,
        graph.range_bearing_edges,
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
    e, _ = observation_errors(seen, poses, points)
    return np.asarray(np.einsum("ki,kij,kj->k", e, seen.information, e))


def observation_errors(seen: Landmarks, poses: Floats, points: Floats) -> tuple[Floats, Floats]:
    """Return the residual of each observation and its derivative by the point.

    Parameters
    ----------
    seen : Landmarks
        The observations.
    poses : ndarray, (l, 3) or (l, 7)
        The pose of each.
    points : ndarray, (l, 2) or (l, 3)
        The landmark of each.

    Returns
    -------
    (errors, jacobians) : ndarray, (l, d), and ndarray, (l, d, d)
        The point in the frame of the pose minus the measurement; or where range and bearing were
        measured its distance minus the range, then the angle between its direction and the measured
        one, in 3D to the left and up. The derivatives are by the point in the world's frame.
    """
    d = seen.dimension
    into = _core.rotation_matrices(np.ascontiguousarray(poses)).transpose(0, 2, 1)
    own = lie.between(poses, as_poses(points))[:, :d]
    e, jacobians = own - seen.measurements, into
    which = seen.is_range_bearing
    if which.any():
        towards = _core.rotation_matrices(directions(seen.measurements[which])).transpose(0, 2, 1)
        q = np.einsum("kij,kj->ki", towards, own[which])
        ranges = np.ascontiguousarray(seen.measurements[which, 0])
        e[which], by_q = _core.range_bearing_errors(np.ascontiguousarray(q), ranges)
        jacobians = jacobians.copy()
        jacobians[which] = by_q @ towards @ into[which]
    return e, jacobians


def measured_poses(seen: Landmarks) -> Floats:
    """Return each observation as the pose of the point in the frame of the pose that saw it.

    Where range and bearing were measured, its x axis points in the measured direction. A range that
    was not measured is 0.
    """
    out = as_poses(seen.measurements)
    which = seen.is_range_bearing
    if which.any():
        ahead = np.zeros((int(which.sum()), seen.dimension))
        ahead[:, 0] = seen.measurements[which, 0]
        out[which] = lie.compose(directions(seen.measurements[which]), as_poses(ahead))
    return out


def measurements_of(poses: Floats, range_bearing: Flags | None) -> Floats:
    """Return observations, (l, 2) or (l, 3), from `measured_poses` of them."""
    d = 2 if poses.shape[1] == 3 else 3
    out = poses[:, :d].copy()
    if range_bearing is None:
        return out
    ahead = lie.to_matrices(poses[range_bearing])[:, :d, 0]
    seen = np.empty((len(ahead), d))
    seen[:, 0] = (ahead * out[range_bearing]).sum(axis=1)
    seen[:, 1] = np.arctan2(ahead[:, 1], ahead[:, 0])
    if d == 3:
        seen[:, 2] = np.arcsin(np.clip(ahead[:, 2], -1, 1))
    out[range_bearing] = seen
    return out


def directions(measurements: Floats) -> Floats:
    """Return poses at the origin whose x axes point in measured directions.

    Parameters
    ----------
    measurements : ndarray, (l, 2) or (l, 3)
        Range, bearing and in 3D elevation.
    """
    out = as_poses(np.zeros_like(measurements))
    if measurements.shape[1] == 2:
        out[:, 2] = measurements[:, 1]
        return out
    left, up = measurements[:, 1] / 2, measurements[:, 2] / 2
    # A rotation about z, then one about the new -y.
    out[:, 3], out[:, 4] = np.sin(left) * np.sin(up), -np.cos(left) * np.sin(up)
    out[:, 5], out[:, 6] = np.sin(left) * np.cos(up), np.cos(left) * np.cos(up)
    return out


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
