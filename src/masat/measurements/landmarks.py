"""Landmarks: points, and what poses saw of them."""

from __future__ import annotations

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
        The point in the frame of the pose, as measured.
    information : ndarray, (l, 2, 2) or (l, 3, 3)
        Inverse covariance of each, symmetric positive semidefinite, in the frame of the pose.
    """

    ids: Ids
    positions: Floats | None
    observations: Ids
    measurements: Floats
    information: Floats

    def __len__(self) -> int:
        return len(self.ids)

    def __repr__(self) -> str:
        return f"Landmarks({len(self)} in {self.dimension}D, {len(self.observations)} observations)"

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
        )


def landmarks(
    observations: ArrayLike,
    measurements: ArrayLike,
    information: ArrayLike | None = None,
    *,
    ids: ArrayLike | None = None,
    positions: ArrayLike | None = None,
) -> Landmarks:
    """Return landmarks from what poses saw of them.

    Parameters
    ----------
    observations : array_like of int, (l, 2)
        Ids (pose, point). Points and poses share no id.
    measurements : array_like, (l, 2) or (l, 3)
        The point in the frame of the pose, in meters.
    information : array_like, (l, d, d) or (d, d), optional
        Inverse covariances, symmetric positive semidefinite. Default: the identity.
    ids : array_like of int, (k,), optional
        Ids of the points in the order of `positions`. Default: those that the observations name,
        ascending.
    positions : array_like, (k, 2) or (k, 3), optional
        Where the points are. Default: a solve places them.

    Returns
    -------
    Landmarks

    Raises
    ------
    GraphError
        If shapes do not fit, numbers are not finite, or an observation names an unknown point.
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
    nodes, given = checks.ascending(nodes, given)
    unknown = ~checks.among(nodes, pairs[:, 1]) if len(nodes) else np.ones(len(pairs), np.bool_)
    for k in np.flatnonzero(unknown)[:1]:
        raise GraphError(f"{name(int(k))} names no landmark of the ids given", edge=int(k))
    return Landmarks(
        nodes, given, pairs, z, checks.semidefinite_matrices(information, len(pairs), d, name)
    )
