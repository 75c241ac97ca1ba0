"""Information matrices: the check that they are positive definite, and their repair."""

from __future__ import annotations

from typing import Literal, TypeAlias

import numpy as np

from masat import _core
from masat.arrays import Floats, Ids

Repair: TypeAlias = Literal["error", "nearest", "identity"]
"""What to do with indefinite information: refuse it, or take the nearest or the identity."""

# Smallest eigenvalue after a repair, as a fraction of the largest: no direction is lost, and the
# normal equations keep half of the digits of a double.
_MIN_EIGENVALUE_RATIO = 1e-9


def indefinite(information: Floats) -> Ids:
    """Return the indices of the matrices, (m, d, d), that are not positive definite."""
    return _core.indefinite(np.ascontiguousarray(information))


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
        The repaired matrices; those that were positive definite are unchanged.
    """
    bad = indefinite(information)
    repaired = information.copy()
    # Numbers near the largest double may overflow; the graph then refuses the result.
    with np.errstate(over="ignore", invalid="ignore"):
        values, vectors = np.linalg.eigh(information[bad])
        values = np.maximum(values, _MIN_EIGENVALUE_RATIO * values[:, -1:])
        product = (vectors * values[:, None, :]) @ vectors.transpose(0, 2, 1)
    repaired[bad] = 0.5 * product + 0.5 * product.transpose(0, 2, 1)
    return repaired
