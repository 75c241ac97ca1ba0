"""Poses in 3D from the points of a path."""

from __future__ import annotations

import numpy as np

from masat import lie
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
    return np.column_stack([points, lie.quaternions(axes)])


def _unit(vectors: Floats) -> Floats:
    scaled: Floats = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    return scaled
