"""The cost of a decision which closures to keep."""

from __future__ import annotations

import numpy as np

from masat.arrays import Flags, Floats
from masat.robust.closures import GATE, Closures

# Rejected closures of one cluster beyond this number cost no more: their errors are not independent.
_MAX_PRICED = 20


def price(closures: Closures, rejected: Flags) -> float:
    """Return what rejected closures cost: for n of a cluster the gate + 2 dof (n - 1), n up to 20.

    The errors of a run of closures are not independent, so that a run costs much less than its
    closures one by one.
    """
    dof = closures.graph.dof
    count = np.bincount(closures.clusters[rejected])
    count = np.minimum(count[count > 0], _MAX_PRICED)
    return float((GATE[dof] + 2 * dof * (count - 1)).sum())


def cost(closures: Closures, kept: Flags, chi2: Floats) -> float:
    """Return chi2 of the trusted edges and the kept closures, and the price of the others.

    Parameters
    ----------
    closures : Closures
        The closures.
    kept : ndarray of bool, (c,)
        Those that are kept.
    chi2 : ndarray, (m,)
        chi2 of each edge of the graph in the map of the kept ones.
    """
    return float(chi2[closures.kept_edges(kept)].sum()) + price(closures, ~kept)
