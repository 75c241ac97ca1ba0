"""Priors and landmarks of a file, with the offsets of the sensors that its parameters tell."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from masat import _core, lie
from masat.arrays import Floats, Ids
from masat.errors import FormatError, GraphError
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
    return _priors(parsed, path), _landmarks(parsed, path)


def _priors(parsed: _core.ParsedGraph, path: Path) -> Priors | None:
    if len(parsed["prior_ids"]) == 0:
        return None
    offsets = _offsets(parsed, parsed["prior_parameters"], parsed["prior_lines"], path)
    try:
        return pose_priors(
            parsed["prior_ids"], parsed["priors"], parsed["prior_information"], offset=offsets
        )
    except GraphError as error:
        row = error.edge if error.node is None else error.node
        raise FormatError(str(error), path, _line(parsed["prior_lines"], row)) from None


def _landmarks(parsed: _core.ParsedGraph, path: Path) -> Landmarks | None:
    ids, pairs = parsed["point_ids"], parsed["observation_ids"]
    if len(ids) == 0 and len(pairs) == 0:
        return None
    z, w = parsed["observations"], parsed["observation_information"]
    lines = parsed["observation_lines"]
    polar = parsed["observation_range_bearing"].astype(np.bool_)
    offsets = _offsets(parsed, parsed["observation_parameters"], lines, path)
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


def _offsets(parsed: _core.ParsedGraph, wanted: Ids, lines: Ids, path: Path) -> Floats | None:
    """Return the pose of the sensor of each line, or None if all are the identity."""
    known, poses = parsed["parameter_ids"], parsed["parameters"]
    out = np.tile(lie.identity(2 if poses.shape[1] == 3 else 3), (len(wanted), 1))
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
    return None if (out == lie.identity(2 if poses.shape[1] == 3 else 3)).all() else out


def _line(lines: Ids, row: int | None) -> int | None:
    return None if row is None else int(lines[row])
