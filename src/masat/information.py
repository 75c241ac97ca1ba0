"""Information matrices: the check that they are positive definite, and two ways out if not."""

from __future__ import annotations

from typing import Literal, TypeAlias

import numpy as np

from masat import _core
from masat.arrays import Floats, Ids

Repair: TypeAlias = Literal["error", "nearest", "identity"]
"""What to do with indefinite information: refuse, take the nearest, or the identity everywhere."""

_FLOOR = 1e-9


def indefinite(information: Floats) -> Ids:
    """Return the indices of the matrices, (m, d, d), that are not positive definite."""
    return _core.indefinite(np.ascontiguousarray(information))


def nearest_positive_definite(information: Floats) -> Floats:
    """Raise the eigenvalues of symmetric matrices to at least 1e-9 of the matrix's largest.

    Clipping at zero gives the nearest positive semidefinite matrix in the Frobenius norm (Higham,
    Computing a nearest symmetric positive semidefinite matrix, 1988, theorem 2.1); the floor keeps
    every direction measured. A matrix without a positive eigenvalue is refused by the graph.

    Parameters
    ----------
    information : ndarray, (m, d, d)
        Symmetric matrices.

    Returns
    -------
    ndarray, (m, d, d)
        The matrices, those that were positive definite unchanged.
    """
    bad = indefinite(information)
    fixed = information.copy()
    # Numbers near the largest double may overflow: the graph refuses what comes of them.
    with np.errstate(over="ignore", invalid="ignore"):
        values, vectors = np.linalg.eigh(information[bad])
        values = np.maximum(values, _FLOOR * values[:, -1:])
        product = (vectors * values[:, None, :]) @ vectors.transpose(0, 2, 1)
    fixed[bad] = 0.5 * product + 0.5 * product.transpose(0, 2, 1)
    return fixed
