"""Operations on SE(2) and SE(3), vectorized over the rows of arrays.

A pose is (x, y, theta) in SE(2) and (x, y, z, qx, qy, qz, qw) in SE(3): meters, radians, unit
quaternions; it maps coordinates of its own frame to those of its parent. The last axis of an array
has 3 or 7 entries, which makes it SE(2) or SE(3); the axes before it broadcast.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from masat import _checks as checks
from masat import _core
from masat.arrays import Floats
from masat.errors import GraphError

DOF = {2: 3, 3: 6}
POSE_SIZE = {2: 3, 3: 7}
# How far the product of a rotation matrix and its transpose may be from the identity. Matrices in
# single precision, as sensors' drivers give them, pass.
_ORTHOGONAL = 1e-6


def identity(dimension: int) -> Floats:
    """Return the identity pose of SE(2) or SE(3), (3,) or (7,)."""
    if dimension not in POSE_SIZE:
        raise GraphError(f"the dimension must be 2 or 3, got {dimension!r:.40}")
    pose = np.zeros(POSE_SIZE[dimension])
    if dimension == 3:
        pose[6] = 1.0
    return pose


def compose(a: ArrayLike, b: ArrayLike) -> Floats:
    """Return a * b: the poses b, given in the frames a, as poses in the parent frame of a.

    Parameters
    ----------
    a, b : array_like, (..., 3) or (..., 7)
        Poses.

    Returns
    -------
    ndarray, (..., 3) or (..., 7)
        Poses, headings in [-pi, pi).

    Raises
    ------
    GraphError
        If the arrays are no poses, or if their shapes do not broadcast to each other. The other
        functions of this module raise it too.
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
    """Return a * X(step): the update that the optimizers apply to a pose.

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
    poses, steps = _poses(a), checks.numbers("steps", step)
    dof = DOF[2 if poses.shape[-1] == 3 else 3]
    if not steps.shape or steps.shape[-1] != dof:
        raise GraphError(
            f"steps must have shape (..., {dof}) to go with the poses, got {steps.shape}"
        )
    shape = _broadcast(poses, steps)
    return _core.retract(_flat(poses, shape), _flat(steps, shape)).reshape(*shape, poses.shape[-1])


def local(a: ArrayLike, b: ArrayLike) -> Floats:
    """Return the step from a to b, the inverse of `retract`: the residual of an edge in g2o.

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


def interpolate(a: ArrayLike, b: ArrayLike, fraction: ArrayLike) -> Floats:
    """Return a * exp(fraction * log(a^-1 * b)): the poses on the way from a to b.

    The body moves with constant velocity and constant angular velocity in its own frame, the
    shorter way around, so the path does not depend on the frame of the map, nor on which point of
    the body the poses describe.

    Parameters
    ----------
    a, b : array_like, (..., 3) or (..., 7)
        Poses.
    fraction : array_like, (...)
        0 gives a, and 1 gives b.

    Returns
    -------
    ndarray, (..., 3) or (..., 7)
        Poses.
    """
    (first, second), shape = _rows(a, b)
    s = np.broadcast_to(checks.numbers("fraction", fraction), shape).reshape(-1, 1)
    step = _core.compose(_core.inverse(first), second)
    planar = step.shape[1] == 3
    spatial = to_3d(step)
    t, v, w = spatial[:, :3], spatial[:, 3:6], spatial[:, 6:]
    v = np.where(w < 0, -v, v)
    sine = np.linalg.norm(v, axis=1, keepdims=True)
    half = np.arctan2(sine, np.abs(w))
    axis = np.divide(v, sine, out=np.zeros_like(v), where=sine > 0)
    # log and exp cancel but for this: the part of t along the axis is scaled by s, the other by the
    # ratio of two chords, and turned by half of the angle that is missing.
    along = axis * np.einsum("ij,ij->i", axis, t)[:, None]
    across = t - along
    ratio = np.divide(np.sin(s * half), np.sin(half), out=s.copy(), where=half > 0)
    turn = (s - 1) * half
    moved = s * along + ratio * (np.cos(turn) * across + np.sin(turn) * np.cross(axis, across))
    if planar:
        part = np.hstack([moved[:, :2], s * step[:, 2:]])
    else:
        part = np.hstack([moved, np.sin(s * half) * axis, np.cos(s * half)])
    return _core.compose(first, np.ascontiguousarray(part)).reshape(*shape, first.shape[1])


def to_3d(a: ArrayLike) -> Floats:
    """Return poses in 3D: those in 2D get z = 0 and their heading about the z axis.

    Parameters
    ----------
    a : array_like, (..., 3) or (..., 7)
        Poses.

    Returns
    -------
    ndarray, (..., 7)
        Poses.
    """
    poses = _poses(a)
    if poses.shape[-1] == 7:
        return poses
    out = np.zeros((*poses.shape[:-1], 7))
    out[..., :2] = poses[..., :2]
    out[..., 5], out[..., 6] = np.sin(poses[..., 2] / 2), np.cos(poses[..., 2] / 2)
    return out


def to_matrices(a: ArrayLike) -> Floats:
    """Return poses as homogeneous matrices.

    Parameters
    ----------
    a : array_like, (..., 3) or (..., 7)
        Poses.

    Returns
    -------
    ndarray, (..., 3, 3) or (..., 4, 4)
        Matrices that map coordinates of the pose's own frame to those of its parent.
    """
    (rows,), shape = _rows(a)
    d = 2 if rows.shape[1] == 3 else 3
    out = np.zeros((len(rows), d + 1, d + 1))
    out[:, :d, :d] = _core.rotation_matrices(rows)
    out[:, :d, d] = rows[:, :d]
    out[:, d, d] = 1.0
    return out.reshape(*shape, d + 1, d + 1)


def from_matrices(matrices: ArrayLike) -> Floats:
    """Return homogeneous matrices as poses.

    Parameters
    ----------
    matrices : array_like, (..., 3, 3) or (..., 4, 4)
        Matrices [R t; 0 1] of rotations R and translations t.

    Returns
    -------
    ndarray, (..., 3) or (..., 7)
        Poses.

    Raises
    ------
    GraphError
        If the shape is another one, or if a matrix is no rotation with a translation, to 1e-6.
    """
    given = checks.numbers("matrices", matrices)
    size = given.shape[-1] if given.ndim else 0
    if given.ndim < 2 or size not in (3, 4) or given.shape[-2] != size:
        raise GraphError(f"matrices must have shape (..., 3, 3) or (..., 4, 4), got {given.shape}")
    d, m = size - 1, given.reshape(-1, size, size)
    r = m[:, :d, :d]
    with np.errstate(over="ignore", invalid="ignore"):
        off = np.abs(r @ r.transpose(0, 2, 1) - np.eye(d)).max(axis=(1, 2))
    last = np.arange(size) == d
    rigid = (off < _ORTHOGONAL) & (np.linalg.det(r) > 0) & (m[:, d] == last).all(axis=1)
    for k in np.flatnonzero(~(rigid & np.isfinite(m).all(axis=(1, 2))))[:1]:
        raise GraphError(f"matrix {k} is no rotation with a translation")
    if d == 2:
        poses = np.column_stack([m[:, :2, 2], np.arctan2(r[:, 1, 0], r[:, 0, 0])])
    else:
        poses = np.column_stack([m[:, :3, 3], quaternions(r)])
    return poses.reshape(*given.shape[:-2], POSE_SIZE[d])


def quaternions(r: Floats) -> Floats:
    """Return qx, qy, qz, qw, (n, 4), of rotation matrices, (n, 3, 3)."""
    x, y, z = r[:, 0, 0], r[:, 1, 1], r[:, 2, 2]
    # 4 q q', whose row with the largest diagonal entry is the most accurate multiple of q.
    q = np.empty((len(r), 4, 4))
    q[:, 0, 0], q[:, 1, 1], q[:, 2, 2] = 1 + x - y - z, 1 - x + y - z, 1 - x - y + z
    q[:, 3, 3] = 1 + x + y + z
    q[:, 0, 1] = q[:, 1, 0] = r[:, 0, 1] + r[:, 1, 0]
    q[:, 0, 2] = q[:, 2, 0] = r[:, 0, 2] + r[:, 2, 0]
    q[:, 1, 2] = q[:, 2, 1] = r[:, 1, 2] + r[:, 2, 1]
    q[:, 0, 3] = q[:, 3, 0] = r[:, 2, 1] - r[:, 1, 2]
    q[:, 1, 3] = q[:, 3, 1] = r[:, 0, 2] - r[:, 2, 0]
    q[:, 2, 3] = q[:, 3, 2] = r[:, 1, 0] - r[:, 0, 1]
    longest = q[np.arange(len(r)), np.einsum("kii->ki", q).argmax(axis=1)]
    out: Floats = longest / np.linalg.norm(longest, axis=1, keepdims=True)
    return out


def _poses(a: ArrayLike) -> Floats:
    poses = checks.numbers("poses", a)
    if not poses.shape or poses.shape[-1] not in POSE_SIZE.values():
        raise GraphError(f"poses must have shape (..., 3) or (..., 7), got {poses.shape}")
    return poses


def _broadcast(*arrays: Floats) -> tuple[int, ...]:
    """Return the common shape of the axes before the last."""
    try:
        return np.broadcast_shapes(*(a.shape[:-1] for a in arrays))
    except ValueError:
        shapes = " and ".join(str(a.shape) for a in arrays)
        raise GraphError(f"arrays of shapes {shapes} do not broadcast to each other") from None


def _flat(a: Floats, shape: tuple[int, ...]) -> Floats:
    size = a.shape[-1]
    return np.ascontiguousarray(np.broadcast_to(a, (*shape, size))).reshape(-1, size)


def _rows(*arrays: ArrayLike) -> tuple[list[Floats], tuple[int, ...]]:
    """Return the arrays as contiguous rows of poses, and the shape that they broadcast to."""
    poses = [_poses(a) for a in arrays]
    if len({p.shape[-1] for p in poses}) > 1:
        shapes = " and ".join(str(p.shape) for p in poses)
        raise GraphError(f"poses in 2D and in 3D cannot be combined, got shapes {shapes}")
    shape = _broadcast(*poses)
    return [_flat(p, shape) for p in poses], shape
