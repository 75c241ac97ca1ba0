"""Latitude, longitude and altitude as coordinates of a local frame, by the package pymap3d."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from masat import _checks as checks
from masat.arrays import Floats
from masat.errors import GraphError, MasatError


def east_north_up(
    latitude: ArrayLike,
    longitude: ArrayLike,
    altitude: ArrayLike = 0.0,
    *,
    origin: tuple[float, float, float] | None = None,
) -> Floats:
    """Return positions in the frame of east, north and up at an origin on the WGS 84 ellipsoid.

    Parameters
    ----------
    latitude, longitude : array_like, (p,)
        In degrees.
    altitude : array_like, (p,) or (), optional
        Meters above the ellipsoid. Default: zero.
    origin : (float, float, float), optional
        Latitude, longitude and altitude of the origin. Default: the first position. Give all
        sessions that are to share a frame the same one.

    Returns
    -------
    ndarray, (p, 3)
        Meters; the first two columns are the positions for a graph in 2D.

    Raises
    ------
    GraphError
        If shapes do not fit, or numbers are not finite or no angles on the Earth.
    MasatError
        If the package pymap3d is not installed: ``pip install "masat[gps]"``.
    """
    lat, lon, alt = (
        checks.numbers(name, values)
        for name, values in (
            ("latitude", latitude),
            ("longitude", longitude),
            ("altitude", altitude),
        )
    )
    if lat.ndim != 1 or lon.shape != lat.shape or alt.shape not in ((), lat.shape):
        raise GraphError(
            f"latitude, longitude and altitude must have one shape (p,), got {lat.shape}, "
            f"{lon.shape} and {alt.shape}"
        )
    alt = np.broadcast_to(alt, lat.shape)
    wrong = ~(np.isfinite(lat) & np.isfinite(lon) & np.isfinite(alt))
    wrong |= (np.abs(lat) > 90) | (np.abs(lon) > 360)
    for k in np.flatnonzero(wrong)[:1]:
        raise GraphError(
            f"position {k} is not on the Earth: latitude {lat[k]}, longitude {lon[k]}, altitude "
            f"{alt[k]}; expected degrees and meters"
        )
    try:
        from pymap3d import geodetic2enu
    except ImportError:
        raise MasatError(
            'latitudes and longitudes need the package pymap3d: pip install "masat[gps]"'
        ) from None
    if len(lat) == 0:
        return np.empty((0, 3))
    at = (lat[0], lon[0], alt[0]) if origin is None else origin
    return np.stack([np.asarray(a, np.float64) for a in geodetic2enu(lat, lon, alt, *at)], axis=1)
