"""The similarity that moves a map onto the truth."""

from __future__ import annotations

from typing import Literal, TypeAlias

import numpy as np

from masat import _core, lie
from masat.arrays import Floats
from masat.errors import EvaluationError

Align: TypeAlias = Literal["none", "origin", "se3", "sim3"]

# Positions that deviate from a line by less than 1e-7 of its length, or are all the same.
_SMALLEST_RATIO = 1e-14


def aligned(
    poses: Floats, truth: Floats, how: Align, *, planar: bool
) -> tuple[Floats, Floats, float]:
    """Return the poses moved onto the true ones, the transform, (7,), and the scale.

    A position p becomes the transform of scale * p.

    Parameters
    ----------
    poses, truth : ndarray, (k, 7)
        Poses that belong together.
    how : {"none", "origin", "se3", "sim3"}
        "origin" moves the first pose onto the first true one. "se3" and "sim3" minimize the sum of
        the squared distances of the positions, "sim3" also over the scale.
    planar : bool
        Whether both maps are in 2D, so that the map turns about the z axis alone.
    """
    if how == "none":
        return poses, lie.identity(3), 1.0
    if how == "origin":
        transform = lie.compose(truth[0], lie.inverse(poses[0]))
        return lie.compose(transform, poses), transform, 1.0
    if how not in ("se3", "sim3"):
        raise EvaluationError(f'align must be "none", "origin", "se3" or "sim3", got {how!r}')
    d = 2 if planar else 3
    _refuse_undetermined(poses[:, :d], truth[:, :d])
    transform, scale = similarity(poses[:, :d], truth[:, :d], with_scale=how == "sim3")
    scaled = poses.copy()
    scaled[:, :3] *= scale
    return lie.compose(transform, scaled), transform, scale


def similarity(x: Floats, y: Floats, *, with_scale: bool = False) -> tuple[Floats, float]:
    """Return the transform, (7,), and the scale c that minimize the sum of |R c x + t - y|^2.

    It is one of several where the points, (k, 2) or (k, 3), are on one line or all the same.
    Source: Umeyama, Least-squares estimation of transformation parameters between two point
    patterns, 1991, equations 34 to 43.
    """
    d = x.shape[1]
    mean_x, mean_y = x.mean(axis=0), y.mean(axis=0)
    from_x, from_y = x - mean_x, y - mean_y
    variance_x = float((from_x**2).sum()) / len(x)
    covariance = from_y.T @ from_x / len(x)
    transform = _core.nearest_rotations(np.ascontiguousarray(covariance[None]))
    rotation = _core.rotation_matrices(transform)[0]
    scale = float((rotation * covariance).sum()) / variance_x if with_scale else 1.0
    transform[0, :d] = mean_y - scale * rotation @ mean_x
    return lie.to_3d(transform[0]), scale


def _refuse_undetermined(x: Floats, y: Floats) -> None:
    """Refuse points that do not determine a rotation."""
    from_x, from_y = x - x.mean(axis=0), y - y.mean(axis=0)
    singular = np.linalg.svd(from_y.T @ from_x, compute_uv=False)
    size = np.sqrt((from_x**2).sum() * (from_y**2).sum())
    if singular[x.shape[1] - 2] <= _SMALLEST_RATIO * size:
        raise EvaluationError(
            "the positions are all the same or on one line, so they do not determine an "
            'alignment: align the first pose ("origin"), or nothing ("none")'
        )
