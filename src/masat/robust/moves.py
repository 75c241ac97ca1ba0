"""Runs of rejected closures are forced into a map, or out of it, where that lowers the cost."""

from __future__ import annotations

import numpy as np

from masat.arrays import Floats, Ids
from masat.progress import Progress
from masat.robust.closures import GATE, Closures
from masat.robust.growth import Growth
from masat.robust.objective import cost, of_run, price

# Runs tried at the most, and the fewest rejected closures in one that is worth a trial.
_MAX_TRIALS, _MIN_AGREEING = 4, 2
# Believed runs that are longer are not taken out; and it takes as many plausible closures that are
# rejected to doubt believed ones.
_MAX_FALSE_RUN, _MIN_BLOCKED = 40, 5
# Squared distance, in prices of a group, beyond which adding it is not tried.
_MAX_EXCESS = 10.0
_LOWER = 1e-6


def improve(closures: Closures, growth: Growth, first: Floats, progress: Progress) -> Growth:
    """Return a growth of lower cost, by forcing rejected runs in and believed ones out.

    A run of closures that agree with each other may have been blocked by another one that was
    believed first. It is believed at once, what then is far beyond its information is dropped, and
    the map grows on. Where closures that the trusted edges alone allow are still rejected, believed
    runs are taken out in the same way. A change is kept if the cost falls.

    Parameters
    ----------
    closures : Closures
        The closures.
    growth : Growth
        A map that no longer grows.
    first : ndarray, (c,)
        Squared distances of the closures from what the trusted edges alone predict.
    progress : Progress
        What reports the stages and limits the time.

    Returns
    -------
    Growth
    """
    lowest = cost(closures, growth.kept, growth.chi2)
    tried: set[tuple[bool, int]] = set()
    trials = {True: _MAX_TRIALS, False: _MAX_TRIALS}
    while not progress.over:
        move = _next_move(closures, growth, first, tried, trials)
        if move is None:
            break
        into, run = move
        tried.add(move)
        trials[into] -= 1
        members = np.flatnonzero((growth.spokesman == run) & (growth.kept != into))
        progress.tell(f"trying {len(members)} loop closures {'in' if into else 'out'}")
        if not into and int(np.count_nonzero(growth.candidates)) <= len(members):
            continue
        trial = growth.copy()
        if not _is_promising(closures, trial, into, members, lowest):
            continue
        trial.grow()
        found = cost(closures, trial.kept, trial.chi2)
        if found < lowest * (1 - _LOWER):
            growth, lowest = trial, found
            # What was refused may be right beside the new map.
            tried = {move}
    return growth


def _is_promising(
    closures: Closures, trial: Growth, into: bool, members: Ids, lowest: float
) -> bool:
    """Make a move, and return whether it is worth the growth that follows."""
    if into:
        trial.believe(members, rough=True)
        left = cost(closures, trial.kept, trial.chi2) - lowest
        return left < price(closures, np.isin(np.arange(len(closures)), members))
    trial.disbelieve(members)
    return trial.count_likely() > len(members)


def _next_move(
    closures: Closures,
    growth: Growth,
    first: Floats,
    tried: set[tuple[bool, int]],
    trials: dict[bool, int],
) -> tuple[bool, int] | None:
    """Return the next run to force in (True) or out (False): the largest not tried, in first."""
    group = growth.spokesman
    gate = GATE[closures.graph.dof]
    size = np.bincount(group, minlength=len(closures))
    kept = np.bincount(group[growth.kept], minlength=len(closures))
    # A true group is one that the trusted edges allow. With a map that it contradicts far beyond
    # its price, it fits only if another one is taken out first.
    allowed = np.bincount(group[first < gate], minlength=len(closures)) * 2 > size
    blocked = ~growth.kept & growth.supported & (first < gate)
    conflict = int(np.count_nonzero(blocked)) >= _MIN_BLOCKED
    chi2 = growth.chi2[closures.edges]
    excess = np.bincount(group, np.where(growth.kept, chi2 - closures.graph.dof, 0.0))
    for into in (True, False):
        if into:
            nearest = np.full(len(closures), np.inf)
            np.minimum.at(nearest, group, np.where(growth.kept, np.inf, growth.distance))
            near = nearest < _MAX_EXCESS * of_run(closures, np.maximum(size - kept, 1))
            possible = np.flatnonzero((size - kept >= _MIN_AGREEING) & allowed & near)
            order = possible[np.argsort(kept[possible] - size[possible], kind="stable")]
        else:
            possible = np.flatnonzero((kept >= _MIN_AGREEING) & (size > 1) & conflict)
            # A group that was split, or that fits badly, is the most doubtful.
            doubt = np.lexsort((-excess[possible], kept[possible] == size[possible]))
            order = possible[doubt]
        for one in order.tolist():
            if trials[into] == 0:
                break
            if (into, one) not in tried:
                return into, one
    return None
