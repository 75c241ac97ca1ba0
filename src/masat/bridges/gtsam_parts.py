"""gtsam's poses and noise models from arrays, and conversely."""

from __future__ import annotations

from typing import Any

import numpy as np

from masat.arrays import Flags, Floats

# Eigenvalues below this fraction of the largest one are zero but for rounding.
_ROUNDED_ZERO = 1e-14


def as_pose(gtsam: Any, pose: Floats) -> Any:
    """Return an array, (3,) or (7,), as a Pose2 or Pose3."""
    if len(pose) == 3:
        return gtsam.Pose2(*pose)
    x, y, z, w = pose[3:]
    return gtsam.Pose3(gtsam.Rot3.Quaternion(w, x, y, z), pose[:3])


def pose_of(pose: Any) -> Floats:
    """Return a Pose2 or Pose3 as an array, (3,) or (7,)."""
    if hasattr(pose, "theta"):
        return np.array([pose.x(), pose.y(), pose.theta()])
    return np.concatenate([pose.translation(), rotation_of(pose.rotation())])


def rotation_of(rotation: Any) -> Floats:
    """Return a Rot2 as its angle, (1,), and a Rot3 as a quaternion, (4,)."""
    if hasattr(rotation, "theta"):
        return np.array([rotation.theta()])
    q = rotation.toQuaternion()
    return np.array([q.x(), q.y(), q.z(), q.w()])


def singular(information: Floats) -> Flags:
    """Return which matrices, (m, d, d), leave a direction without information."""
    values = np.linalg.eigvalsh(information)
    return np.asarray(values[:, 0] <= _ROUNDED_ZERO * values[:, -1])


def noise_model(gtsam: Any, information: Floats) -> Any:
    """Return a noise model with this information, (d, d), which may be semidefinite."""
    if not singular(information[None])[0]:
        return gtsam.noiseModel.Gaussian.Information(information)
    lengths, axes = np.linalg.eigh(information)
    root = np.sqrt(np.maximum(lengths, 0))[:, None] * axes.T
    return gtsam.noiseModel.Gaussian.SqrtInformation(root, False)
