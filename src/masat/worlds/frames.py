"""Poses in 3D from the points of a path."""

from __future__ import annotations

import numpy as np

from masat.arrays import Floats


def facing(points: Floats, up: Floats) -> Floats:
    """Return poses at the points of a path, each facing the next point.

    Parameters
    ----------
    points : ndarray, (n, 3)
        Points of the path in meters; consecutive points differ.
    up : ndarray, (n, 3) or (3,)
        Directions near which the z axes point; nowhere parallel to the path.

    Returns
    -------
    ndarray, (n, 7)
        Poses whose x axes point ahead and y axes to the left; the last faces as the one before.
    """
    steps = np.diff(points, axis=0)
    ahead = _unit(np.concatenate([steps, steps[-1:]]))
    left = _unit(np.cross(up, ahead))
    axes = np.stack([ahead, left, np.cross(ahead, left)], axis=2)
    return np.column_stack([points, _quaternions(axes)])


def _unit(vectors: Floats) -> Floats:
    scaled: Floats = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    return scaled


def _quaternions(r: Floats) -> Floats:
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
    largest = np.einsum("kii->ki", q).argmax(axis=1)
    return _unit(q[np.arange(len(r)), largest])
