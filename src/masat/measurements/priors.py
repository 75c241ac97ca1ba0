"""Priors: measurements of nodes in the world's frame."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from masat import _checks as checks
from masat import lie
from masat.arrays import Flags, Floats, Ids, LockedArrays
from masat.errors import GraphError
from masat.residuals import as_poses


@dataclass(frozen=True, eq=False, repr=False)
class Priors(LockedArrays):
    """Measurements of nodes in the world's frame, one a row.

    The residual of a prior is the step from what was measured to the pose, as of an edge from the
    world. Information of zero in a direction says that it was not measured. Make priors with
    `masat.gps`, `masat.headings`, `masat.altitudes` or `masat.pose_priors`, and join several by +.

    Attributes
    ----------
    ids : ndarray of int64, (p,)
        The node of each prior, a pose or a landmark. A node may have several.
    measurements : ndarray, (p, 3) or (p, 7)
        Poses in the world's frame, as measured. What was not measured is zero, or the identity.
    information : ndarray, (p, 3, 3) or (p, 6, 6)
        Inverse covariances, symmetric positive semidefinite, in the order of the edges' ones. They
        refer to the axes of the measurement: to those of the world where its rotation is the
        identity.
    offsets : ndarray, (p, 3) or (p, 7), or None
        Pose of the sensor in the frame of the node, where it is not the identity for all of them.
    """

    ids: Ids
    measurements: Floats
    information: Floats
    offsets: Floats | None = None

    def __len__(self) -> int:
        return len(self.ids)

    def __repr__(self) -> str:
        return f"Priors({len(self)} in {self.dimension}D)"

    @property
    def dimension(self) -> int:
        """2 or 3."""
        return 2 if self.measurements.shape[1] == 3 else 3

    def __add__(self, other: Priors) -> Priors:
        if not isinstance(other, Priors):
            return NotImplemented
        if other.dimension != self.dimension:
            raise GraphError("priors in 2D and in 3D cannot be joined")
        offsets = None
        if self.offsets is not None or other.offsets is not None:
            offsets = np.concatenate([_offsets_or_identity(part) for part in (self, other)])
        return Priors(
            np.concatenate([self.ids, other.ids]),
            np.concatenate([self.measurements, other.measurements]),
            np.concatenate([self.information, other.information]),
            offsets,
        )

    def rows(self, which: Flags | Ids) -> Priors:
        """Return some of the priors, given by a mask or by indices."""
        return Priors(
            self.ids[which],
            self.measurements[which],
            self.information[which],
            None if self.offsets is None else self.offsets[which],
        )

    def renamed(self, ids: Ids) -> Priors:
        """Return the same priors on other nodes."""
        return replace(self, ids=ids)


def pose_priors(
    ids: ArrayLike,
    poses: ArrayLike,
    information: ArrayLike | None = None,
    *,
    offset: ArrayLike | None = None,
) -> Priors:
    """Return priors on full poses, or on what of them the information measures.

    Parameters
    ----------
    ids : array_like of int, (p,)
        Ids of the nodes.
    poses : array_like, (p, 3) or (p, 7)
        Poses in the world's frame, as measured.
    information : array_like, (p, d, d) or (d, d), optional
        Inverse covariances, symmetric positive semidefinite; d is 3 or 6. Default: the identity.
    offset : array_like, (3,) or (7,), or one a row, optional
        Pose of the sensor in the frame of the node. Default: the identity.

    Returns
    -------
    Priors

    Raises
    ------
    GraphError
        If shapes do not fit, or numbers are not finite; it names the first node.
    InformationError
        If information is not symmetric positive semidefinite, or is zero.
    """
    nodes = checks.node_ids(ids)
    z = checks.table("poses of priors", poses)
    if z.ndim == 2 and z.shape[1] == 0:
        z = z.reshape(0, 3)
    if z.shape[1] not in lie.POSE_SIZE.values() or len(z) != len(nodes):
        raise GraphError(
            f"poses of priors must have shape ({len(nodes)}, 3) or ({len(nodes)}, 7), got {z.shape}"
        )
    z = checks.rotations(z, "prior", nodes, "node")
    matrices = checks.semidefinite_matrices(
        information,
        len(nodes),
        lie.DOF[2 if z.shape[1] == 3 else 3],
        lambda k: f"the prior of node {nodes[k]}",
    )
    return Priors(nodes, z, matrices, _offset(offset, nodes, z.shape[1]))


def gps(
    ids: ArrayLike,
    positions: ArrayLike,
    sigma: ArrayLike,
    *,
    lever_arm: ArrayLike | None = None,
) -> Priors:
    """Return priors on positions, as satellite navigation or a total station measures them.

    Parameters
    ----------
    ids : array_like of int, (p,)
        Ids of the nodes, poses or landmarks.
    positions : array_like, (p, 2) or (p, 3)
        Measured positions in the world's frame, in meters, such as east, north and up;
        `masat.east_north_up` makes them of latitude and longitude.
    sigma : array_like, (), (d,) or (p, d)
        Standard deviations in meters: one number for all, one a coordinate, or one a coordinate of
        each fix.
    lever_arm : array_like, (d,) or (p, d), optional
        Position of the antenna in the frame of the node. Default: zero.

    Returns
    -------
    Priors

    Raises
    ------
    GraphError
        If shapes do not fit, numbers are not finite, or a sigma is not positive.

    Examples
    --------
    >>> import masat
    >>> masat.gps([0, 20], [(0, 0), (18.5, 3.1)], sigma=2.0)
    Priors(2 in 2D)
    """
    nodes = checks.node_ids(ids)
    where = checks.table("positions", positions)
    where = where.reshape(0, 2) if where.shape[1] == 0 else where
    if where.shape not in ((len(nodes), 2), (len(nodes), 3)):
        raise GraphError(
            f"positions must have shape ({len(nodes)}, 2) or ({len(nodes)}, 3), got {where.shape}"
        )
    p, d = where.shape
    arms = None
    if lever_arm is not None:
        arm = checks.numbers("lever_arm", lever_arm)
        if arm.shape not in ((d,), (p, d)):
            raise GraphError(f"lever_arm must have shape ({d},) or ({p}, {d}), got {arm.shape}")
        arms = as_poses(np.broadcast_to(arm, (p, d)))
    return pose_priors(nodes, as_poses(where), _diagonal(sigma, p, d, range(d), nodes), offset=arms)


def headings(ids: ArrayLike, angles: ArrayLike, sigma: ArrayLike) -> Priors:
    """Return priors on headings in 2D, as a compass or two antennas measure them.

    Parameters
    ----------
    ids : array_like of int, (p,)
        Ids of the nodes.
    angles : array_like, (p,)
        Headings in the world's frame, in radians, counterclockwise from its x axis.
    sigma : array_like, () or (p,)
        Standard deviations in radians.

    Returns
    -------
    Priors
    """
    nodes = checks.node_ids(ids)
    poses = np.zeros((len(nodes), 3))
    poses[:, 2] = _row("angles", angles, len(nodes))
    return pose_priors(nodes, poses, _diagonal(_column(sigma), len(nodes), 2, [2], nodes))


def altitudes(ids: ArrayLike, heights: ArrayLike, sigma: ArrayLike) -> Priors:
    """Return priors on the z coordinates of nodes in 3D, as a barometer measures them.

    Parameters
    ----------
    ids : array_like of int, (p,)
        Ids of the nodes.
    heights : array_like, (p,)
        The z coordinates in the world's frame, in meters.
    sigma : array_like, () or (p,)
        Standard deviations in meters.

    Returns
    -------
    Priors
    """
    nodes = checks.node_ids(ids)
    where = np.zeros((len(nodes), 3))
    where[:, 2] = _row("heights", heights, len(nodes))
    return pose_priors(nodes, as_poses(where), _diagonal(_column(sigma), len(nodes), 3, [2], nodes))


def joined(priors: Priors | Iterable[Priors] | None) -> Priors | None:
    """Return one table of one or several, or None if there is no prior."""
    if priors is None or isinstance(priors, Priors):
        return priors if priors is not None and len(priors) else None
    parts = list(priors)
    for part in parts:
        if not isinstance(part, Priors):
            raise GraphError(
                f"priors must be made by masat.gps, masat.pose_priors and the like, got "
                f"{type(part).__name__}"
            )
    filled = [part for part in parts if len(part)]
    if not filled:
        return None
    out = filled[0]
    for part in filled[1:]:
        out = out + part
    return out


def _row(name: str, values: ArrayLike, count: int) -> Floats:
    row = checks.numbers(name, values)
    if row.shape not in ((), (count,)):
        raise GraphError(f"{name} must have shape ({count},), got {row.shape}")
    return row


def _column(sigma: ArrayLike) -> Floats:
    values = checks.numbers("sigma", sigma)
    return values[:, None] if values.ndim == 1 else values


def _diagonal(
    sigma: ArrayLike, count: int, d: int, directions: Iterable[int], nodes: Ids
) -> Floats:
    """Return information matrices with 1 / sigma^2 in some directions and zero in the others."""
    where = list(directions)
    values = checks.numbers("sigma", sigma)
    allowed = ((), (len(where),), (count, len(where)))
    if values.shape not in allowed:
        raise GraphError(f"sigma must have a shape of {allowed}, got {values.shape}")
    rows = np.broadcast_to(values, (count, len(where)))
    for k in np.flatnonzero(~((rows > 0) & np.isfinite(rows)).all(axis=1))[:1]:
        raise GraphError(f"sigma of node {nodes[k]} must be positive and finite, got {rows[k]}")
    out = np.zeros((count, lie.DOF[d], lie.DOF[d]))
    out[:, where, where] = 1 / np.square(rows)
    return out


def _offset(offset: ArrayLike | None, nodes: Ids, size: int) -> Floats | None:
    if offset is None:
        return None
    given = checks.numbers("offset", offset)
    if given.shape not in ((size,), (len(nodes), size)):
        raise GraphError(
            f"offset must have shape ({size},) or ({len(nodes)}, {size}), got {given.shape}"
        )
    rows = np.array(np.broadcast_to(given, (len(nodes), size)), order="C")
    rows = checks.rotations(rows, "offset", nodes, "node")
    return None if (rows == lie.identity(2 if size == 3 else 3)).all() else rows


def _offsets_or_identity(priors: Priors) -> Floats:
    if priors.offsets is not None:
        return priors.offsets
    return np.tile(lie.identity(priors.dimension), (len(priors), 1))
