"""Runs of rejected closures are forced into a map where that lowers the cost."""

from __future__ import annotations

import numpy as np

from masat.progress import Progress
from masat.robust.closures import Closures
from masat.robust.growth import Growth
from masat.robust.objective import cost

# Runs tried at the most, and the fewest rejected closures in one that is worth a trial.
_MAX_TRIALS, _MIN_AGREEING = 12, 2
_LOWER = 1e-6


def improve(closures: Closures, growth: Growth, progress: Progress) -> Growth:
    """Return a growth of lower cost, by forcing rejected runs in.

    A run of closures that agree with each other may have been blocked by another one that was
    believed first. It is believed at once, what then is far beyond its information is dropped, and
    the map grows on; the change is kept if the cost falls.

    Parameters
    ----------
    closures : Closures
        The closures.
    growth : Growth
        A map that no longer grows.
    progress : Progress
        What reports the stages and limits the time.

    Returns
    -------
    Growth
    """
    lowest = cost(closures, growth.kept, growth.chi2)
    tried: set[int] = set()
    while len(tried) < _MAX_TRIALS and not progress.over:
        run = _largest_rejected(growth, tried)
        if run is None:
            break
        tried.add(run)
        members = np.flatnonzero((growth.runs == run) & ~growth.kept)
        progress.tell(f"trying {len(members)} rejected loop closures that agree")
        trial = growth.copy()
        trial.believe(members)
        trial.grow()
        found = cost(closures, trial.kept, trial.chi2)
        if found < lowest * (1 - _LOWER):
            growth, lowest = trial, found
    return growth


def _largest_rejected(growth: Growth, tried: set[int]) -> int | None:
    """Return the run with most rejected closures, of those not tried."""
    count = np.bincount(growth.runs[~growth.kept], minlength=1)
    count[[run for run in tried if run < len(count)]] = 0
    largest = int(count.argmax())
    return largest if count[largest] >= _MIN_AGREEING else None
