"""Whole clusters of closures are added to a map where that lowers the cost."""

from __future__ import annotations

import numpy as np

from masat.arrays import Ids
from masat.progress import Progress
from masat.robust.closures import Closures
from masat.robust.growth import Growth
from masat.robust.objective import cost

# Clusters tried at the most, and the fewest closures that agree in one that is worth a trial.
_MAX_TRIALS, _MIN_AGREEING = 12, 2
_LOWER = 1e-6


def improve(closures: Closures, growth: Growth, progress: Progress) -> Growth:
    """Return a growth of lower cost, by forcing rejected clusters in.

    A cluster of closures that agree with each other may have been blocked by another one that was
    believed first. Each is believed at once, what then is far beyond its information is dropped,
    and the map grows on; the change is kept if the cost falls.

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
    for members in _rejected_clusters(closures, growth):
        if progress.over:
            break
        progress.tell(f"trying a cluster of {len(members)} rejected loop closures")
        trial = growth.copy()
        trial.believe(members)
        trial.grow()
        found = cost(closures, trial.kept, trial.chi2)
        if found < lowest * (1 - _LOWER):
            growth, lowest = trial, found
    return growth


def _rejected_clusters(closures: Closures, growth: Growth) -> list[Ids]:
    """Return the clusters that are rejected whole and agree in themselves, the largest first."""
    clusters = closures.clusters
    count = int(clusters.max()) + 1 if len(clusters) else 0
    rejected = np.bincount(clusters[growth.kept], minlength=count) == 0
    agreeing = np.bincount(clusters[growth.supported], minlength=count)
    worth = np.flatnonzero(rejected & (agreeing >= _MIN_AGREEING))
    worth = worth[np.argsort(-agreeing[worth], kind="stable")][:_MAX_TRIALS]
    return [np.flatnonzero((clusters == k) & growth.supported) for k in worth]
