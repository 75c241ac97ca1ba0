"""Landmarks: points, and what poses saw of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from masat import _checks as checks
from masat.arrays import Flags, Floats, Ids, LockedArrays
from masat.errors import GraphError


@dataclass(frozen=True, eq=False, repr=False)
class Landmarks(LockedArrays):
    """Points, and what poses saw of them.

    Attributes
    ----------
    ids : ndarray of int64, (k,)
        Ids of the points, ascending; no pose has one of them.
    positions : ndarray, (k, 2) or (k, 3), or None
        Where they are, in meters. None until they are given or solved for.
    observations : ndarray of int64, (l, 2)
        Ids (pose, point) of each observation.
    measurements : ndarray, (l, 2) or (l, 3)
        The point in the frame of the pose, as measured: x, y and in 3D z in meters; or where
        `range_bearing` is set range, bearing and in 3D elevation, in meters and radians.
    information : ndarray, (l, 2, 2) or (l, 3, 3)
        Inverse covariance of each, symmetric positive semidefinite, in the order of the
        measurement.
    range_bearing : ndarray of bool, (l,), or None
        Which observations measure range and bearing; None if none does.
    """

    ids: Ids
    positions: Floats | None
    observations: Ids
    measurements: Floats
    information: Floats
    range_bearing: Flags | None = None

    def __len__(self) -> int:
        return len(self.ids)

    def __repr__(self) -> str:
        return f"Landmarks({len(self)} in {self.dimension}D, {len(self.observations)} observations)"

    def __add__(self, other: Landmarks) -> Landmarks:
        if not isinstance(other, Landmarks):
            return NotImplemented
        if other.dimension != self.dimension:
            raise GraphError("landmarks in 2D and in 3D cannot be joined")
        ids = checks.distinct(np.concatenate([self.ids, other.ids]))
        flags = None
        if self.range_bearing is not None or other.range_bearing is not None:
            flags = np.concatenate([self.is_range_bearing, other.is_range_bearing])
        return Landmarks(
            ids,
            _joined_positions(ids, self, other),
            np.concatenate([self.observations, other.observations]),
            np.concatenate([self.measurements, other.measurements]),
            np.concatenate([self.information, other.information]),
            flags,
        )

    @property
    def is_range_bearing(self) -> Flags:
        """Which observations measure range and bearing, (l,), also if none does."""
        if self.range_bearing is None:
            return np.zeros(len(self.observations), np.bool_)
        return self.range_bearing

    @property
    def dimension(self) -> int:
        """2 or 3."""
        return int(self.measurements.shape[1])

    def with_positions(self, positions: ArrayLike) -> Landmarks:
        """Return the landmarks at other positions, (k, 2) or (k, 3) in the order of `ids`."""
        given = checks.table("positions of landmarks", positions)
        if given.shape != (len(self.ids), self.dimension):
            raise GraphError(
                f"positions of landmarks must have shape ({len(self.ids)}, {self.dimension}), got "
                f"{given.shape}"
            )
        return replace(self, positions=checks.finite(given, "position of landmark", self.ids))

    def observed(self, which: Flags | Ids) -> Landmarks:
        """Return all the points with some of the observations, given by a mask or by indices."""
        return replace(
            self,
            observations=self.observations[which],
            measurements=self.measurements[which],
            information=self.information[which],
            range_bearing=_if_any(self.is_range_bearing[which]),
        )


def landmarks(
    observations: ArrayLike,
    measurements: ArrayLike,
    information: ArrayLike | None = None,
    *,
    ids: ArrayLike | None = None,
    positions: ArrayLike | None = None,
    range_bearing: ArrayLike = False,
) -> Landmarks:
    """Return landmarks from what poses saw of them.

    Of ranges and bearings alone `masat.range_bearing` makes them with less to write. Join several
    by +.

    Parameters
    ----------
    observations : array_like of int, (l, 2)
        Ids (pose, point). Points and poses share no id.
    measurements : array_like, (l, 2) or (l, 3)
        The point in the frame of the pose, in meters; or range, bearing and in 3D elevation.
    information : array_like, (l, d, d) or (d, d), optional
        Inverse covariances, symmetric positive semidefinite. Default: the identity.
    ids : array_like of int, (k,), optional
        Ids of the points in the order of `positions`. Default: those that the observations name,
        ascending.
    positions : array_like, (k, 2) or (k, 3), optional
        Where the points are. Default: a solve places them.
    range_bearing : bool or array_like of bool, (l,)
        Which measurements are range, bearing and in 3D elevation.

    Returns
    -------
    Landmarks

    Raises
    ------
    GraphError
        If shapes do not fit, numbers are not finite, an observation names an unknown point, a range
        is negative, or an elevation is beyond a right angle.
    InformationError
        If information is not symmetric positive semidefinite, or is zero.
    """
    pairs = checks.pairs_of_ids(observations)
    z = checks.table("measurements of landmarks", measurements)
    given = None if positions is None else checks.table("positions of landmarks", positions)
    if z.shape[1] == 0:
        z = z.reshape(0, 2 if given is None else given.shape[1])
    if z.shape[1] not in (2, 3) or len(z) != len(pairs):
        raise GraphError(
            f"measurements of landmarks must have shape ({len(pairs)}, 2) or ({len(pairs)}, 3), "
            f"got {z.shape}"
        )
    nodes = checks.distinct(pairs[:, 1]) if ids is None else checks.node_ids(ids)
    d = z.shape[1]
    if given is not None:
        if given.shape != (len(nodes), d):
            raise GraphError(
                f"positions of landmarks must have shape ({len(nodes)}, {d}), got {given.shape}"
            )
        given = checks.finite(given, "position of landmark", nodes)

    def name(k: int) -> str:
        return f"observation {k} ({pairs[k, 0]} -> {pairs[k, 1]})"

    for k in np.flatnonzero(~np.isfinite(z).all(axis=1))[:1]:
        raise GraphError(f"the measurement of {name(int(k))} is not finite", edge=int(k))
    flags = _flags(range_bearing, len(pairs))
    if flags is not None:
        _check_ranges(z, flags, name)
    nodes, given = checks.ascending(nodes, given)
    unknown = ~checks.among(nodes, pairs[:, 1]) if len(nodes) else np.ones(len(pairs), np.bool_)
    for k in np.flatnonzero(unknown)[:1]:
        raise GraphError(f"{name(int(k))} names no landmark of the ids given", edge=int(k))
    matrices = checks.semidefinite_matrices(information, len(pairs), d, name, "observations")
    return Landmarks(nodes, given, pairs, z, matrices, flags)


def joined_landmarks(parts: Landmarks | Iterable[Landmarks | None] | None) -> Landmarks | None:
    """Return one table of one or several, or None if there is none."""
    if parts is None or isinstance(parts, Landmarks):
        return parts
    out: Landmarks | None = None
    for part in parts:
        if part is None:
            continue
        if not isinstance(part, Landmarks):
            raise GraphError(
                "landmarks must be made by masat.landmarks or masat.range_bearing, got "
                f"{type(part).__name__}"
            )
        out = part if out is None else out + part
    return out


def _joined_positions(ids: Ids, a: Landmarks, b: Landmarks) -> Floats | None:
    """Return the positions of all landmarks, or None if some have none; they must agree."""
    out = np.full((len(ids), a.dimension), np.nan)
    for part in (a, b):
        if part.positions is not None:
            rows = np.searchsorted(ids, part.ids)
            known = ~np.isnan(out[rows, 0])
            differ = known & (out[rows] != part.positions).any(axis=1)
            for node in part.ids[differ][:1]:
                raise GraphError(
                    f"landmark {node} has two different positions: give one of them alone"
                )
            out[rows] = part.positions
    return None if np.isnan(out).any() else out


def _if_any(flags: Flags) -> Flags | None:
    return flags if flags.any() else None


def _flags(given: ArrayLike, count: int) -> Flags | None:
    flags = np.asarray(given)
    if flags.shape not in ((), (count,)) or (flags.dtype != np.bool_ and flags.size):
        raise GraphError(
            f"range_bearing must be true or false, or {count} of these, one an observation"
        )
    return _if_any(np.array(np.broadcast_to(flags.astype(np.bool_), count)))


def _check_ranges(z: Floats, flags: Flags, name: Callable[[int], str]) -> None:
    for k in np.flatnonzero(flags & (z[:, 0] < 0))[:1]:
        raise GraphError(
            f"the range of {name(int(k))} is {z[k, 0]:g} m: it must not be negative", edge=int(k)
        )
    if z.shape[1] == 3:
        # Rounding may have brought a right angle a little beyond it.
        for k in np.flatnonzero(flags & (np.abs(z[:, 2]) > np.pi / 2 + 1e-6))[:1]:
            raise GraphError(
                f"the elevation of {name(int(k))} is {z[k, 2]:g}: it must be from -pi/2 to pi/2, "
                "in radians",
                edge=int(k),
            )
