"""gtsam's factors of ranges and bearings of landmarks.

gtsam has the bearing before the range. In 3D its bearing is a `Unit3`, whose residual is in two
directions that it chooses itself, so information on them is held only if it is the same in all
directions.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np

from masat import lie
from masat.arrays import Floats
from masat.bridges.gtsam_parts import noise_model
from masat.errors import GraphError
from masat.measurements import Landmarks, landmarks
from masat.residuals import directions

# Fraction of information up to which differences between directions are rounding.
_ISOTROPIC = 1e-12


class Seen(NamedTuple):
    """An observation: ids (pose, point), range, bearing and in 3D elevation, and information."""

    ends: tuple[int, int]
    measurement: Floats
    information: Floats


def observation_factors(gtsam: Any, seen: Landmarks) -> Iterator[Any]:
    """Yield gtsam's factor of each observation.

    Raises
    ------
    GraphError
        If an observation is no range or bearing, or if in 3D the information on its direction is
        not the same in all directions or is correlated with that on the range. It names it.
    """
    d = seen.dimension
    for k, (pose, point) in enumerate(seen.observations.tolist()):
        z, w = seen.measurements[k], seen.information[k]
        name = f"observation {k} ({pose} -> {point})"
        if not seen.is_range_bearing[k]:
            raise GraphError(
                f"{name} measures a position in the frame of the pose, for which gtsam has no "
                "factor: give its range and bearing with masat.range_bearing"
            )
        if d == 3:
            _check_isotropic(w, name)
        has_range, has_bearing = w[0, 0] > 0, bool(w[1:, 1:].any())
        if has_range and has_bearing:
            order = [*range(1, d), 0]
            kind = gtsam.BearingRangeFactor2D if d == 2 else gtsam.BearingRangeFactor3D
            noise = noise_model(gtsam, w[np.ix_(order, order)])
            yield kind(pose, point, _bearing(gtsam, z), z[0], noise)
        elif has_range:
            kind = gtsam.RangeFactor2D if d == 2 else gtsam.RangeFactor3D
            yield kind(pose, point, z[0], noise_model(gtsam, w[:1, :1]))
        else:
            kind = gtsam.BearingFactor2D if d == 2 else gtsam.BearingFactor3D
            yield kind(pose, point, _bearing(gtsam, z), noise_model(gtsam, w[1:, 1:]))


def read_observation(gtsam: Any, factor: Any, matrix: Callable[[], Floats]) -> Seen | None:
    """Return the observation of a factor, or None if the factor is none.

    Parameters
    ----------
    gtsam : module
        The package.
    factor : gtsam.Factor
        The factor.
    matrix : callable
        Returns its information in gtsam's order.
    """
    kind = type(factor)
    both = {gtsam.BearingRangeFactor2D: 2, gtsam.BearingRangeFactor3D: 3}
    ranges = {gtsam.RangeFactor2D: 2, gtsam.RangeFactor3D: 3}
    bearings = {gtsam.BearingFactor2D: 2, gtsam.BearingFactor3D: 3}
    d = both.get(kind) or ranges.get(kind) or bearings.get(kind)
    if d is None:
        return None
    z, w = np.zeros(d), np.zeros((d, d))
    measured, information = factor.measured(), matrix()
    if kind in both:
        z[0], z[1:] = measured.range(), _angles(measured.bearing())
        order = [d - 1, *range(d - 1)]
        w[:] = information[np.ix_(order, order)]
    elif kind in ranges:
        z[0], w[0, 0] = measured, information[0, 0]
    else:
        z[1:], w[1:, 1:] = _angles(measured), information
    if d == 3:
        _check_isotropic(w, f"a {kind.__name__} of the keys {list(factor.keys())}")
    pose, point = factor.keys()
    return Seen((pose, point), z, w)


def joined_observations(
    seen: list[Seen], points: dict[int, Floats], dimension: int
) -> Landmarks | None:
    """Return the landmarks of some observations and known positions; None if there is neither."""
    ids = sorted({*(s.ends[1] for s in seen), *points})
    if not ids:
        return None
    return landmarks(
        np.array([s.ends for s in seen], np.int64).reshape(-1, 2),
        np.array([s.measurement for s in seen]).reshape(-1, dimension),
        np.array([s.information for s in seen]).reshape(-1, dimension, dimension),
        ids=ids,
        positions=[points[k] for k in ids] if len(points) == len(ids) else None,
        range_bearing=len(seen) > 0,
    )


def _bearing(gtsam: Any, z: Floats) -> Any:
    if len(z) == 2:
        return gtsam.Rot2(z[1])
    return gtsam.Unit3(lie.to_matrices(directions(z[None]))[0, :3, 0])


def _angles(bearing: Any) -> Floats:
    if hasattr(bearing, "theta"):
        return np.array([bearing.theta()])
    x, y, z = bearing.point3()
    return np.array([np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))])


def _check_isotropic(w: Floats, name: str) -> None:
    direction = w[1:, 1:]
    even = direction[0, 0] * np.eye(2)
    if np.abs(direction - even).max() > _ISOTROPIC * direction.max(initial=0) or w[0, 1:].any():
        raise GraphError(
            f"{name} has information on its direction that is not the same in all directions, or "
            "that is correlated with the range: masat and gtsam measure directions along different "
            "axes in 3D"
        )
