"""Information matrices: check, repair, and isotropic weights in their place."""

from __future__ import annotations

from typing import Literal, NamedTuple, TypeAlias

import numpy as np

from masat import _core
from masat.arrays import Floats, Ids

Repair: TypeAlias = Literal["error", "nearest", "identity"]
"""What to do with indefinite information: refuse it, or take the nearest or the identity."""

# How far below zero rounding may take an eigenvalue that is zero, the diagonal being 1.
_ROUNDED_ZERO = 1e-14
# Smallest eigenvalue after a repair, as a fraction of the largest: no direction is lost, and the
# normal equations keep half of the digits of a double.
_MIN_EIGENVALUE_RATIO = 1e-9

# Rotation before translation, and a rotation vector in place of the vector part of a quaternion,
# which is half of it.
_ROTATION_FIRST = [3, 4, 5, 0, 1, 2]
_HALVES = np.array([2.0, 2.0, 2.0, 1.0, 1.0, 1.0])


def for_rotation_vectors(information: Floats) -> Floats:
    """Return information of poses, (m, d, d), as gtsam and Open3D have it.

    In 3D they put the rotation first and measure it by the rotation vector. To first order that is
    twice the vector part of the quaternion. In 2D nothing changes.
    """
    if information.shape[-1] == 3:
        return information
    order = _ROTATION_FIRST
    return np.asarray(information[..., order, :][..., order] / np.outer(_HALVES, _HALVES))


def from_rotation_vectors(information: Floats) -> Floats:
    """Return information of gtsam or Open3D, (m, d, d), in the order of `PoseGraph`.

    It is the inverse of `for_rotation_vectors`, without rounding.
    """
    if information.shape[-1] == 3:
        return information
    # The order exchanges two halves, so it is its own inverse.
    order = _ROTATION_FIRST
    return np.asarray((information * np.outer(_HALVES, _HALVES))[..., order, :][..., order])


def indefinite(information: Floats) -> Ids:
    """Return the indices of the matrices, (m, d, d), that are not positive definite."""
    return _core.indefinite(np.ascontiguousarray(information))


def not_semidefinite(information: Floats) -> Ids:
    """Return the indices of the matrices, (m, d, d), that are zero or not positive semidefinite."""
    bad = indefinite(information)
    if len(bad) == 0:
        return bad
    rows = information[bad]
    diagonal = np.einsum("kii->ki", rows)
    fine = (diagonal >= 0).all(axis=1) & diagonal.any(axis=1)
    # A direction without information has no part in the others either.
    fine &= ~((diagonal == 0)[:, :, None] & (rows != 0)).any(axis=(1, 2))
    scaled = _scaled(rows)
    # Of a semidefinite matrix no entry is beyond 1 now.
    fine &= (np.abs(scaled) <= 1 + _ROUNDED_ZERO).all(axis=(1, 2))
    fine[fine] = np.linalg.eigvalsh(scaled[fine])[:, 0] >= -_ROUNDED_ZERO
    wrong: Ids = bad[~fine]
    return wrong


def nearest_positive_definite(information: Floats) -> Floats:
    """Raise the eigenvalues of indefinite matrices to at least 1e-9 of the matrix's largest.

    Clipping at zero would give the nearest positive semidefinite matrix in the Frobenius norm
    (Higham, Computing a nearest symmetric positive semidefinite matrix, 1988, theorem 2.1). The
    small positive bound makes it definite. A matrix without a positive eigenvalue stays indefinite,
    and the graph refuses it.

    Parameters
    ----------
    information : ndarray, (m, d, d)
        Symmetric matrices.

    Returns
    -------
    ndarray, (m, d, d)
        The repaired matrices; those that were positive semidefinite are unchanged.
    """
    bad = not_semidefinite(information)
    repaired = information.copy()
    # Numbers near the largest double may overflow; the graph then refuses the result.
    with np.errstate(over="ignore", invalid="ignore"):
        values, vectors = np.linalg.eigh(information[bad])
        values = np.maximum(values, _MIN_EIGENVALUE_RATIO * values[:, -1:])
        product = (vectors * values[:, None, :]) @ vectors.transpose(0, 2, 1)
    repaired[bad] = 0.5 * product + 0.5 * product.transpose(0, 2, 1)
    return repaired


def measured_directions(information: Floats) -> int:
    """Return in how many directions matrices, (m, d, d), have information, all added up."""
    every = int(np.prod(information.shape[:2]))
    open_ = partial(information)
    if len(open_) == 0:
        return every
    values = np.linalg.eigvalsh(_scaled(information[open_]))
    return every - int(np.count_nonzero(values <= _ROUNDED_ZERO))


class IsotropicWeights(NamedTuple):
    """One number per edge, (m,), for its rotation and one for its translation."""

    rotation: Floats
    translation: Floats


def isotropic_weights(information: Floats) -> IsotropicWeights:
    """Return isotropic weights that stand in for information matrices, (m, d, d).

    A translation weighs d / trace(inverse of its block). For rotations see `rotation_weights`.
    Source: Rosen, Carlone, Bandeira, Leonard, SE-Sync, IJRR 2019, section 3.
    """
    d = 2 if information.shape[1] == 3 else 3
    translation = d / _trace_of_inverse(information[:, :d, :d])
    return IsotropicWeights(rotation_weights(information), translation)


def rotation_weights(information: Floats) -> Floats:
    """Return the isotropic weights of the rotations, (m,).

    They make the chordal cost, weight |R_j - R_i R|^2, equal the chi2 of small residuals: half the
    information of an angle in 2D, an eighth of that of the quaternion's vector part in 3D.
    """
    d = 2 if information.shape[1] == 3 else 3
    rotation = information[:, d:, d:]
    if d == 2:
        return rotation[:, 0, 0] / 2
    return 3 / _trace_of_inverse(rotation) / 8


def partial(information: Floats) -> Ids:
    """Return the indices of the matrices, (m, d, d), that have no information in some direction."""
    return indefinite(information)


def inverse_root(information: Floats) -> Floats:
    """Return matrices R, (m, d, d), so that R u has this information if u is unit noise.

    R u is zero in directions without information.
    """
    diagonal = np.einsum("kii->ki", information)
    scale = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    values, vectors = np.linalg.eigh(_scaled(information))
    measured = values > _ROUNDED_ZERO
    roots = np.where(measured, 1 / np.sqrt(np.where(measured, values, 1.0)), 0.0)
    return np.asarray(vectors * roots[:, None] / scale[:, :, None])


def _scaled(information: Floats) -> Floats:
    """Return matrices of diagonal 1, or 0: neither units nor the largest double matter to them."""
    diagonal = np.einsum("kii->ki", information)
    scale = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    with np.errstate(over="ignore"):
        return np.asarray(information / scale[:, :, None] / scale[:, None])


def _trace_of_inverse(a: Floats) -> Floats:
    """Return the traces of the inverses of matrices, (m, 2, 2) or (m, 3, 3).

    By the Cholesky factor L: the sum of the squares of its inverse. Positive, however badly
    conditioned; infinite where a semidefinite matrix leaves a direction without information.
    """
    d = a.shape[1]
    singular = indefinite(a)
    if len(singular):
        out = np.full(len(a), np.inf)
        rest = np.delete(np.arange(len(a)), singular)
        out[rest] = _trace_of_inverse(np.ascontiguousarray(a[rest]))
        return out
    scale = np.einsum("kii->k", a)
    a = a / scale[:, None, None]

    def root(pivot: Floats, of: Floats) -> Floats:
        return np.asarray(np.sqrt(np.maximum(pivot, np.finfo(np.float64).eps * of)))

    l00 = root(a[:, 0, 0], a[:, 0, 0])
    l10 = a[:, 1, 0] / l00
    l11 = root(a[:, 1, 1] - l10**2, a[:, 1, 1])
    i00, i11 = 1 / l00, 1 / l11
    i10 = -l10 * i00 * i11
    total = i00**2 + i10**2 + i11**2
    if d == 3:
        l20 = a[:, 2, 0] / l00
        l21 = (a[:, 2, 1] - l20 * l10) / l11
        i22 = 1 / root(a[:, 2, 2] - l20**2 - l21**2, a[:, 2, 2])
        i21 = -l21 * i11 * i22
        i20 = -(l20 * i00 + l21 * i10) * i22
        total = total + i20**2 + i21**2 + i22**2
    return np.asarray(total / scale)
