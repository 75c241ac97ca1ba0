"""Operations on SE(2) and SE(3), vectorized over the rows of arrays.

A pose is (x, y, theta) in SE(2) and (x, y, z, qx, qy, qz, qw) in SE(3): meters, radians, unit
quaternions; it maps coordinates of its own frame to those of its parent. The last axis of an array
tells the group; the axes before it broadcast.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from masat import _core
from masat.arrays import Floats

DOF = {2: 3, 3: 6}
POSE_SIZE = {2: 3, 3: 7}


def identity(dimension: int) -> Floats:
    """Return the identity pose of SE(2) or SE(3), (3,) or (7,)."""
    pose = np.zeros(POSE_SIZE[dimension])
    if dimension == 3:
        pose[6] = 1.0
    return pose


def compose(a: ArrayLike, b: ArrayLike) -> Floats:
    """Return a * b: the poses b, given in the frames a, in the parent of a.

    Parameters
    ----------
    a, b : array_like, (..., 3) or (..., 7)
        Poses.

    Returns
    -------
    ndarray, (..., 3) or (..., 7)
        Poses, headings in [-pi, pi).
    """
    (first, second), shape = _rows(a, b)
    return _core.compose(first, second).reshape(*shape, first.shape[1])


def inverse(a: ArrayLike) -> Floats:
    """Return the inverses of poses, (..., 3) or (..., 7)."""
    (rows,), shape = _rows(a)
    return _core.inverse(rows).reshape(*shape, rows.shape[1])


def between(a: ArrayLike, b: ArrayLike) -> Floats:
    """Return a^-1 * b: the poses b as seen from a. Shapes as in `compose`."""
    return compose(inverse(a), b)


def retract(a: ArrayLike, step: ArrayLike) -> Floats:
    """Return a * X(step), the optimizers' update of a pose.

    Parameters
    ----------
    a : array_like, (..., 3) or (..., 7)
        Poses.
    step : array_like, (..., 3) or (..., 6)
        (x, y, theta), or translation and vector part of a unit quaternion, in the frame of a.

    Returns
    -------
    ndarray, (..., 3) or (..., 7)
        Poses.
    """
    poses, steps = _poses(a), np.asarray(step, np.float64)
    dof = DOF[2 if poses.shape[-1] == 3 else 3]
    if not steps.shape or steps.shape[-1] != dof:
        raise ValueError(f"steps must have {dof} numbers a pose, got shape {steps.shape}")
    shape = np.broadcast_shapes(poses.shape[:-1], steps.shape[:-1])
    return _core.retract(_flat(poses, shape), _flat(steps, shape)).reshape(*shape, poses.shape[-1])


def local(a: ArrayLike, b: ArrayLike) -> Floats:
    """Return the step from a to b, the inverse of `retract`: g2o's error of an edge.

    Parameters
    ----------
    a, b : array_like, (..., 3) or (..., 7)
        Poses.

    Returns
    -------
    ndarray, (..., 3) or (..., 6)
        (x, y, theta), or translation and vector part of the quaternion with qw >= 0, of a^-1 * b.
    """
    (first, second), shape = _rows(a, b)
    steps = _core.local(first, second)
    return steps.reshape(*shape, steps.shape[1])


def _poses(a: ArrayLike) -> Floats:
    poses = np.asarray(a, np.float64)
    if not poses.shape or poses.shape[-1] not in POSE_SIZE.values():
        raise ValueError(f"poses must have shape (..., 3) or (..., 7), got {poses.shape}")
    return poses


def _flat(a: Floats, shape: tuple[int, ...]) -> Floats:
    size = a.shape[-1]
    return np.ascontiguousarray(np.broadcast_to(a, (*shape, size))).reshape(-1, size)


def _rows(*arrays: ArrayLike) -> tuple[list[Floats], tuple[int, ...]]:
    """Return the arrays as contiguous rows of poses, and the shape that they broadcast to."""
    poses = [_poses(a) for a in arrays]
    if len({p.shape[-1] for p in poses}) > 1:
        raise ValueError("poses of SE(2) and SE(3) do not mix")
    shape = np.broadcast_shapes(*(p.shape[:-1] for p in poses))
    return [_flat(p, shape) for p in poses], shape
