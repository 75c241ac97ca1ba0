"""Priors and landmarks of a file, with the offsets of the sensors that its parameters tell."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from masat import _checks as checks
from masat import _core, lie
from masat.arrays import Floats, Ids
from masat.errors import FormatError, GraphError
from masat.graph import PoseGraph
from masat.measurements import Landmarks, Priors, landmarks, pose_priors
from masat.residuals import as_poses

_NO_PARAMETER = -1


def read_measurements(
    parsed: _core.ParsedGraph, path: Path
) -> tuple[Priors | None, Landmarks | None]:
    """Return the priors and the landmarks of a parsed file, checked.

    Raises
    ------
    FormatError
        If they are not valid, naming the line.
    """
    sensors = _sensors(parsed, path)
    return _priors(parsed, sensors, path), _landmarks(parsed, sensors, path)


def with_measurements(
    graph: PoseGraph,
    parsed: _core.ParsedGraph,
    priors: Priors | None,
    landmarks: Landmarks | None,
    path: Path,
) -> PoseGraph:
    """Return the graph of a file with its priors and landmarks.

    Raises
    ------
    FormatError
        If they do not fit the graph, naming the line.
    """
    try:
        graph = graph.with_landmarks(landmarks)
    except GraphError as error:
        line = _line(parsed["observation_lines"], error.edge)
        if landmarks is not None and error.node is not None:
            line = _first_line(parsed, int(landmarks.ids[error.node]))
        raise FormatError(str(error), path, line) from None
    try:
        return graph.with_priors(priors)
    except GraphError as error:
        raise FormatError(str(error), path, _line(parsed["prior_lines"], error.node)) from None


def _priors(parsed: _core.ParsedGraph, sensors: Floats, path: Path) -> Priors | None:
    if len(parsed["prior_ids"]) == 0:
        return None
    wanted = parsed["prior_parameters"]
    offsets = _offsets(parsed["parameter_ids"], sensors, wanted, parsed["prior_lines"], path)
    try:
        return pose_priors(
            parsed["prior_ids"], parsed["priors"], parsed["prior_information"], offset=offsets
        )
    except GraphError as error:
        row = error.edge if error.node is None else error.node
        raise FormatError(str(error), path, _line(parsed["prior_lines"], row)) from None


def _landmarks(parsed: _core.ParsedGraph, sensors: Floats, path: Path) -> Landmarks | None:
    ids, pairs = parsed["point_ids"], parsed["observation_ids"]
    if len(ids) == 0 and len(pairs) == 0:
        return None
    z, w = parsed["observations"], parsed["observation_information"]
    lines = parsed["observation_lines"]
    wanted = parsed["observation_parameters"]
    polar = parsed["observation_range_bearing"].astype(np.bool_)
    offsets = _offsets(parsed["parameter_ids"], sensors, wanted, lines, path)
    if offsets is not None:
        # Lines of ranges and bearings refer to no parameter.
        d, own = z.shape[1], np.flatnonzero(~polar)
        z[own] = lie.compose(offsets[own], as_poses(z[own]))[:, :d]
        turn = _core.rotation_matrices(offsets[own])
        moved = turn @ w[own] @ turn.transpose(0, 2, 1)
        w[own] = 0.5 * (moved + moved.transpose(0, 2, 1))
    with_points = len(ids) > 0
    try:
        return landmarks(
            pairs,
            z if len(z) else np.zeros((0, parsed["points"].shape[1])),
            w,
            ids=ids if with_points else None,
            positions=parsed["points"] if with_points else None,
            range_bearing=polar,
        )
    except GraphError as error:
        if error.node is not None:
            raise FormatError(str(error), path, _line(parsed["point_lines"], error.node)) from None
        raise FormatError(str(error), path, _line(lines, error.edge)) from None


def _sensors(parsed: _core.ParsedGraph, path: Path) -> Floats:
    """Return the poses of sensors that the parameters of the file tell, checked."""
    try:
        return checks.rotations(
            parsed["parameters"], "offset", parsed["parameter_ids"], "parameter"
        )
    except GraphError as error:
        raise FormatError(str(error), path, _line(parsed["parameter_lines"], error.node)) from None


def _offsets(known: Ids, poses: Floats, wanted: Ids, lines: Ids, path: Path) -> Floats | None:
    """Return the pose of the sensor of each line, or None if all are the identity."""
    identity = lie.identity(2 if poses.shape[1] == 3 else 3)
    out = np.tile(identity, (len(wanted), 1))
    asked = np.flatnonzero(wanted != _NO_PARAMETER)
    order = np.argsort(known, kind="stable")
    at = np.searchsorted(known[order], wanted[asked]).clip(max=max(len(known) - 1, 0))
    found = known[order][at] == wanted[asked] if len(known) else np.zeros(len(asked), np.bool_)
    for k in asked[~found][:1]:
        raise FormatError(
            f"the line refers to the parameter {wanted[k]}, which the file does not define "
            "(PARAMS_SE2OFFSET, PARAMS_SE3OFFSET)",
            path,
            int(lines[k]),
        )
    out[asked] = poses[order][at]
    return None if (out == identity).all() else out


def _first_line(parsed: _core.ParsedGraph, point: int) -> int:
    """Return the line where a landmark first occurs: its vertex, or else an observation."""
    lines = parsed["point_lines"][parsed["point_ids"] == point]
    seen = parsed["observation_lines"][parsed["observation_ids"][:, 1] == point]
    return int([*lines, *seen][0])


def _line(lines: Ids, row: int | None) -> int | None:
    return None if row is None else int(lines[row])
