"""The format of g2o: poses, landmarks, edges, priors, observations and FIX.

Information is the upper triangle, row by row, in the order of the residual: x, y, theta in 2D, the
translation and the vector part of the quaternion in 3D. A prior of a position refers to the axes of
the world, an observation of a landmark to those of the sensor. PARAMS_SE2OFFSET and
PARAMS_SE3OFFSET are poses of sensors in the frame of the robot, to which other lines refer by their
ids. Source: Kuemmerle et al., g2o: a general
framework for graph optimization, ICRA 2011. g2o knows bearings in 2D alone; other ranges and
bearings have tags of masat's own, EDGE_RANGE_BEARING_SE2_XY and EDGE_RANGE_BEARING_SE3_XYZ.
"""

from __future__ import annotations

import numpy as np

from masat import lie
from masat._core import format_lines, rotation_matrices
from masat.arrays import Flags, Floats, Ids
from masat.construction import named_poses
from masat.errors import GraphError
from masat.formats.labels import label_texts
from masat.formats.stamps import stamp_texts
from masat.formats.table import Format, Kind, PoseText, Record
from masat.graph import PoseGraph
from masat.measurements import Landmarks, Priors

_TAGS = {2: ("VERTEX_SE2", "EDGE_SE2"), 3: ("VERTEX_SE3:QUAT", "EDGE_SE3:QUAT")}
_POINT_TAGS = {2: ("VERTEX_XY", "EDGE_SE2_XY"), 3: ("VERTEX_TRACKXYZ", "EDGE_SE3_TRACKXYZ")}
_BEARING_TAG = "EDGE_BEARING_SE2_XY"
# g2o has no tag for a range: these are masat's own, built as g2o's are.
_RANGE_TAGS = {2: "EDGE_RANGE_BEARING_SE2_XY", 3: "EDGE_RANGE_BEARING_SE3_XYZ"}
# Tags of the types slam2d, slam3d and their add-ons that are skipped, and what they mean.
_SKIPPED = {
    "EDGE_SE2_XY_CALIB": "observations of landmarks whose sensor offset is estimated too",
    "EDGE_SE2_OFFSET": "relative poses of two sensors",
    "EDGE_SE3_OFFSET": "relative poses of two sensors",
    "EDGE_POINTXY": "relative positions of two landmarks",
    "EDGE_POINTXYZ": "relative positions of two landmarks",
    "EDGE_SE2_TWOPOINTSXY": "observations of two landmarks in one",
    "EDGE_SE2_LOTSOFXY": "observations of many landmarks in one",
    "EDGE_SE3_LOTSOF_XYZ": "observations of many landmarks in one",
    "EDGE_PROJECT_DEPTH": "depth images of landmarks",
    "EDGE_PROJECT_DISPARITY": "stereo images of landmarks",
    "PARAMS_CAMERACALIB": "calibrations of cameras",
    "PARAMS_STEREOCAMERACALIB": "calibrations of stereo cameras",
    "CACHE_SE2_OFFSET": "intermediate results of g2o",
    "CACHE_SE3_OFFSET": "intermediate results of g2o",
    "CACHE_CAMERA": "intermediate results of g2o",
    "VERTEX_PLANE": "planes",
    "EDGE_PLANE": "relations of planes",
    "EDGE_SE3_PLANE_CALIB": "observations of planes",
    "VERTEX_LINE2D": "lines",
    "VERTEX_LINE3D": "lines",
    "VERTEX_SEGMENT2D": "segments of lines",
    "EDGE_LINE2D": "relations of lines",
    "EDGE_LINE2D_POINTXY": "relations of lines and landmarks",
    "EDGE_SE2_LINE2D": "observations of lines",
    "EDGE_SE3_LINE3D": "observations of lines",
    "EDGE_SE2_SEGMENT2D": "observations of segments",
    "EDGE_SE2_SEGMENT2D_LINE": "observations of segments",
    "EDGE_SE2_SEGMENT2D_POINTLINE": "observations of segments",
    "EDGE_SE3_CALIB": "relative poses whose sensor offset is estimated too",
}


def format_graph(graph: PoseGraph) -> bytes:
    """Return the graph as g2o text, whose numbers read back as the same doubles."""
    more = graph.priors is not None or graph.landmarks is not None
    if graph.poses is None and len(graph.edges) == 0 and not more:
        raise GraphError("a graph with neither poses nor edges cannot be written")
    if graph.poses is None and graph.stamps is not None:
        raise GraphError(
            "the stamps cannot be written, since a graph without poses has no lines of vertices: "
            "give it poses with masat.initialize, or remove the stamps with `with_stamps(None)`"
        )
    labels = getattr(graph, "labels", None)
    vertex, edge = _TAGS[graph.dimension]
    values = np.hstack([graph.measurements, _upper(graph.information)])
    if graph.poses is not None:
        stamps = [] if graph.stamps is None else stamp_texts(graph.stamps)
        vertices = format_lines(vertex, graph.ids[:, None], graph.poses, stamps, "stamp")
        fixed = graph.fixed
    else:
        # A node that nothing measures has no line that FIX could refer to.
        named = named_poses(graph.edges, graph.priors, graph.landmarks)
        vertices, fixed = b"", graph.fixed[np.isin(graph.fixed, named)]
    return (
        vertices
        + _points(graph)
        + format_lines("FIX", fixed[:, None], np.empty((len(fixed), 0)))
        + format_lines(
            edge,
            graph.edges,
            np.ascontiguousarray(values),
            [] if labels is None else label_texts(labels),
        )
        + (_measured(graph) if more else b"")
    )


def _points(graph: PoseGraph) -> bytes:
    if graph.points is None:
        _refuse_unseen(graph)
        return b""
    return format_lines(_POINT_TAGS[graph.dimension][0], graph.point_ids[:, None], graph.points)


def _refuse_unseen(graph: PoseGraph) -> None:
    """Refuse landmarks without a position that no pose saw, for which there is no line."""
    seen = graph.landmarks
    if seen is None:
        return
    for point in np.setdiff1d(seen.ids, seen.observations[:, 1])[:1]:
        raise GraphError(
            f"the landmark {point} has no position and no pose saw it, so g2o has no line for it: "
            "solve the graph first, or give positions (masat.landmarks), before it is written"
        )


def _measured(graph: PoseGraph) -> bytes:
    """Return the lines of priors, observations and the parameters that they refer to."""
    d, priors, seen = graph.dimension, graph.priors, graph.landmarks
    # Parameter 0 is the identity.
    offsets = lie.identity(d)[None]
    of_prior = np.zeros(0 if priors is None else len(priors), np.int64)
    if priors is not None and priors.offsets is not None:
        if d == 2:
            raise GraphError(
                "g2o has no tag for priors in 2D with a lever arm or an offset: the graph cannot "
                "be written"
            )
        offsets, inverse = np.unique(
            np.concatenate([offsets, priors.offsets]), axis=0, return_inverse=True
        )
        inverse = inverse.ravel()
        first = inverse[0]
        # The identity changes its place with what comes first.
        order = np.arange(len(offsets))
        order[[0, first]] = order[[first, 0]]
        offsets, of_prior = offsets[order], order[inverse[1:]]
    text = b""
    if d == 3:
        text += format_lines("PARAMS_SE3OFFSET", np.arange(len(offsets))[:, None], offsets)
    if priors is not None:
        text += _prior_lines(priors, of_prior, np.isin(priors.ids, graph.point_ids))
    if seen is not None:
        text += _observation_lines(seen)
    return text


def _observation_lines(seen: Landmarks) -> bytes:
    """Return the lines of observations in their order: one block a run of the same tag."""
    d, polar = seen.dimension, seen.is_range_bearing
    bearing_alone = polar & (d == 2) & ~seen.information[:, 0].any(axis=1)
    bearing_alone &= seen.measurements[:, 0] == 0
    text = b""
    for run in _runs(np.where(bearing_alone, 2, polar)):
        ids, z, w = seen.observations[run], seen.measurements[run], seen.information[run]
        if bearing_alone[run[0]]:
            tag, z, w = _BEARING_TAG, z[:, 1:], w[:, 1:, 1:]
        elif polar[run[0]]:
            tag = _RANGE_TAGS[d]
        else:
            tag = _POINT_TAGS[d][1]
            if d == 3:
                ids = np.column_stack([ids, np.zeros(len(ids), np.int64)])
        text += format_lines(tag, np.ascontiguousarray(ids), np.hstack([z, _upper(w)]))
    return text


def _runs(kind: Ids) -> list[Ids]:
    """Return the indices of each run of equal values."""
    if len(kind) == 0:
        return []
    return np.split(np.arange(len(kind)), np.flatnonzero(np.diff(kind)) + 1)


def _prior_lines(priors: Priors, parameters: Ids, on_point: Flags) -> bytes:
    """Return the lines of priors in their order: one block a run of the same tag."""
    d = priors.dimension
    turned = priors.information[:, d:].any(axis=(1, 2))
    turned |= (priors.measurements[:, d:] != lie.identity(d)[d:]).any(axis=1)
    # In 3D there is no tag that all versions of g2o read for a position alone.
    kind = np.where(on_point, 0, np.where(turned | (d == 3), 2, 1))
    text = b""
    for run in _runs(kind):
        ids, z = priors.ids[run][:, None], priors.measurements[run]
        w = priors.information[run]
        if kind[run[0]] == 0:
            w = _in_axes_of_world(z, w)
        if kind[run[0]] == 0:
            tag = "EDGE_PRIOR_XY" if d == 2 else "EDGE_POINTXYZ_PRIOR"
        else:
            tag = ("EDGE_PRIOR_SE2_XY", "EDGE_PRIOR_SE2")[kind[run[0]] - 1]
        if kind[run[0]] < 2:
            z, w = z[:, :d], w[:, :d, :d]
        elif d == 3:
            tag, ids = "EDGE_SE3_PRIOR", np.column_stack([ids[:, 0], parameters[run]])
        text += format_lines(tag, np.ascontiguousarray(ids), np.hstack([z, _upper(w)]))
    return text


def _in_axes_of_world(measurements: Floats, information: Floats) -> Floats:
    """Return information matrices of positions in the world's axes, not the measurements' own."""
    d = 2 if measurements.shape[1] == 3 else 3
    turned = (measurements[:, d:] != lie.identity(d)[d:]).any(axis=1)
    turn = rotation_matrices(np.ascontiguousarray(measurements[turned]))
    w = information.copy()
    rotated = turn @ information[turned, :d, :d] @ turn.transpose(0, 2, 1)
    w[turned, :d, :d] = 0.5 * (rotated + rotated.transpose(0, 2, 1))
    return w


def _upper(information: Floats) -> Floats:
    """Return the upper triangles of matrices, row by row."""
    rows, columns = np.triu_indices(information.shape[1])
    return information[:, rows, columns]


FORMAT = Format(
    name="g2o",
    summary="g2o: poses, edges, FIX, priors and landmarks of slam2d and slam3d",
    records=(
        Record("EDGE_SE2", Kind.EDGE),
        Record("VERTEX_SE2", Kind.VERTEX),
        Record("EDGE_SE3:QUAT", Kind.EDGE, PoseText.XYZ_QUATERNION, information_optional=True),
        Record("VERTEX_SE3:QUAT", Kind.VERTEX, PoseText.XYZ_QUATERNION),
        Record("FIX", Kind.FIX),
        Record("EDGE_PRIOR_SE2", Kind.PRIOR),
        Record("EDGE_PRIOR_SE2_XY", Kind.PRIOR, PoseText.XY),
        Record("EDGE_PRIOR_XY", Kind.PRIOR, PoseText.XY),
        Record("EDGE_SE3_PRIOR", Kind.PRIOR, PoseText.XYZ_QUATERNION, parameter=True),
        # The position of the node itself: g2o does not apply the parameter here.
        Record("EDGE_SE3_XYZ_PRIOR", Kind.PRIOR, PoseText.XYZ, parameter=True),
        Record("EDGE_POINTXYZ_PRIOR", Kind.PRIOR, PoseText.XYZ),
        Record("VERTEX_XY", Kind.POINT, PoseText.XY),
        Record("VERTEX_TRACKXYZ", Kind.POINT, PoseText.XYZ),
        Record("EDGE_SE2_XY", Kind.OBSERVATION, PoseText.XY),
        Record("EDGE_SE2_POINTXY_OFFSET", Kind.OBSERVATION, PoseText.XY, parameter=True),
        Record("EDGE_SE3_TRACKXYZ", Kind.OBSERVATION, PoseText.XYZ, parameter=True),
        Record(_BEARING_TAG, Kind.OBSERVATION, PoseText.BEARING),
        Record(_RANGE_TAGS[2], Kind.OBSERVATION, PoseText.RANGE_BEARING),
        Record(_RANGE_TAGS[3], Kind.OBSERVATION, PoseText.RANGE_BEARING_ELEVATION),
        Record("PARAMS_SE2OFFSET", Kind.PARAMETER),
        Record("PARAMS_SE3OFFSET", Kind.PARAMETER, PoseText.XYZ_QUATERNION),
    ),
    skipped=_SKIPPED,
    format_graph=format_graph,
    suffixes=(".g2o", ".txt", ""),
)
