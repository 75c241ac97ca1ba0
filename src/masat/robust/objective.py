"""The cost of a decision which closures to keep."""

from __future__ import annotations

from typing import Any

import numpy as np

from masat.arrays import Flags, Floats
from masat.quantiles import GATE
from masat.robust.closures import Closures

# Closures of one place in a row whose errors may have one cause.
_RUN = 20


def price(closures: Closures, rejected: Flags) -> float:
    """Return what rejected closures cost: each run of n gate + 2 dof (n - 1).

    The errors of a run of closures are not independent, so that a run costs much less than its
    closures one by one. The rejected closures of a place make runs of at most 20.
    """
    count = np.bincount(closures.clusters[rejected])
    runs, rest = np.divmod(count, _RUN)
    return float((runs * of_run(closures, _RUN)).sum() + of_run(closures, rest[rest > 0]).sum())


def of_run(closures: Closures, count: Any) -> Any:
    """Return the price of runs of so many closures."""
    dof = closures.graph.dof
    return GATE[dof] + 2 * dof * (np.asarray(count) - 1)


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
