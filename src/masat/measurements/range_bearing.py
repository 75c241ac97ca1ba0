"""Landmarks of which distances and directions were measured."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from masat import _checks as checks
from masat.arrays import Floats, Ids
from masat.errors import GraphError
from masat.measurements.landmarks import Landmarks, landmarks


def range_bearing(
    observations: ArrayLike,
    ranges: ArrayLike | None = None,
    bearings: ArrayLike | None = None,
    elevations: ArrayLike | None = None,
    *,
    sigma_range: ArrayLike | None = None,
    sigma_bearing: ArrayLike | None = None,
    sigma_elevation: ArrayLike | None = None,
    dimension: int | None = None,
    ids: ArrayLike | None = None,
    positions: ArrayLike | None = None,
) -> Landmarks:
    """Return landmarks from ranges, bearings or both, as a laser, a radar or a camera saw them.

    Parameters
    ----------
    observations : array_like of int, (l, 2)
        Ids (pose, point). Points and poses share no id.
    ranges : array_like, (l,), optional
        Distances in meters. Without them bearings alone were measured.
    bearings : array_like, (l,), optional
        Angles in radians in the frame of the pose, counterclockwise from its x axis; in 3D within
        its xy plane. Without them ranges alone were measured.
    elevations : array_like, (l,), optional
        In 3D, with bearings: angles in radians above the xy plane of the pose.
    sigma_range : array_like, () or (l,), optional
        Standard deviations of the ranges in meters.
    sigma_bearing : array_like, () or (l,), optional
        Standard deviations of the bearings in radians. In 3D they are those of the direction to
        its left: where an encoder measures the bearing, its own times the cosine of the elevation.
    sigma_elevation : array_like, () or (l,), optional
        Standard deviations of the elevations in radians. Default: as `sigma_bearing`.
    dimension : int, optional
        2 or 3. Needed for ranges alone in 3D. Default: 3 with elevations, else 2.
    ids, positions : array_like, optional
        Ids of the points and where they are, as in `masat.landmarks`.

    Returns
    -------
    Landmarks
        Join those of several sensors by +.

    Raises
    ------
    GraphError
        If shapes do not fit, numbers are not finite, a range is negative, a sigma is not positive
        or is missing, or there are neither ranges nor bearings.

    Examples
    --------
    >>> import masat
    >>> masat.range_bearing(
    ...     [(0, 100), (1, 100)], [5.0, 4.1], [0.4, 0.5], sigma_range=0.1, sigma_bearing=0.02
    ... )
    Landmarks(1 in 2D, 2 observations)
    """
    pairs = checks.pairs_of_ids(observations)
    d = (2 if elevations is None else 3) if dimension is None else dimension
    if d not in (2, 3):
        raise GraphError(f"the dimension must be 2 or 3, got {dimension!r:.40}")
    if elevations is not None and d == 2:
        raise GraphError("elevations are measured in 3D: leave them out, or the dimension")
    if ranges is None and bearings is None:
        raise GraphError("give ranges, bearings or both")
    if d == 3 and (bearings is None) != (elevations is None):
        raise GraphError("in 3D a direction has a bearing and an elevation: give both or neither")
    if sigma_elevation is None:
        sigma_elevation = sigma_bearing if elevations is not None else None
    z, w = np.zeros((len(pairs), d)), np.zeros((len(pairs), d, d))
    columns = (
        ("ranges", ranges, "sigma_range", sigma_range),
        ("bearings", bearings, "sigma_bearing", sigma_bearing),
        ("elevations", elevations, "sigma_elevation", sigma_elevation),
    )
    for k, (name, values, sigma_name, sigma) in enumerate(columns):
        if (values is None) != (sigma is None):
            missing, given = (sigma_name, name) if sigma is None else (name, sigma_name)
            raise GraphError(f"{given} without {missing}: give both or neither")
        if values is not None and sigma is not None:
            z[:, k] = _column(name, values, pairs)
            w[:, k, k] = 1 / np.square(_positive(sigma_name, sigma, pairs))
    return landmarks(pairs, z, w, ids=ids, positions=positions, range_bearing=True)


def _column(name: str, values: ArrayLike, pairs: Ids) -> Floats:
    given = checks.numbers(name, values)
    if given.shape not in ((), (len(pairs),)):
        raise GraphError(
            f"{name} must be one number or {len(pairs)}, one an observation, got shape "
            f"{given.shape}"
        )
    row: Floats = np.broadcast_to(given, len(pairs))
    return row


def _positive(name: str, values: ArrayLike, pairs: Ids) -> Floats:
    row = _column(name, values, pairs)
    for k in np.flatnonzero(~((row > 0) & np.isfinite(row)))[:1]:
        raise GraphError(
            f"{name} of observation {k} ({pairs[k, 0]} -> {pairs[k, 1]}) must be positive and "
            f"finite, got {row[k]:g}",
            edge=int(k),
        )
    return row
