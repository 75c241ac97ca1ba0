"""Groups of closures are tried in a map, or taken out of it, where that lowers the cost."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from masat.arrays import AnyArray, Flags, Floats, Ids
from masat.progress import Progress
from masat.robust.closures import GATE, Closures
from masat.robust.growth import Growth
from masat.robust.objective import cost, of_run

# Trials after which no other is made: of adding and of taking out; where closures are few, each
# counts, and a trial costs little.
_MAX_TRIALS = {True: 3, False: 3}
_MAX_TRIALS_OF_FEW = {True: 8, False: 4}
# It takes as many plausible closures that are rejected to doubt kept ones.
_MIN_BLOCKED = 5
# Squared distance, in prices of a group, beyond which adding it is not tried; and in gates, beyond
# which the trusted edges alone exclude it.
_MAX_EXCESS, _MAX_DRIFT = 10.0, 10.0
# Fraction by which a move has to lower the cost, and gates after which others get a new chance.
_LOWER, _LARGE_GAIN = 1e-6, 2.0


class Move(NamedTuple):
    """A group of closures to add to the map (`into`) or to take out of it."""

    into: bool
    group: int


class Decided(NamedTuple):
    """The map of the lowest cost, and the other one that came nearest.

    Attributes
    ----------
    growth : Growth
        The map of the lowest cost.
    cost : float
        Its cost.
    other : ndarray of bool, (c,), or None
        The closures that the second best hypothesis keeps.
    other_cost : float
        Its cost; infinite without one.
    """

    growth: Growth
    cost: float
    other: Flags | None
    other_cost: float


def improve(closures: Closures, growth: Growth, first: Floats, progress: Progress) -> Decided:
    """Return a growth of lower cost, by adding rejected groups and taking out kept ones.

    A group of closures that agree with each other may have been blocked by another one that was
    believed first. It is believed at once, what then is far beyond its information is dropped, and
    the map grows on. Where closures that the trusted edges alone allow are still rejected, kept
    groups are taken out in the same way. A change is kept if the cost falls.

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
    Decided
    """
    best = Decided(growth, cost(closures, growth.kept, growth.chi2), None, np.inf)
    tried: set[Move] = set()
    limits = _MAX_TRIALS_OF_FEW if closures.few else _MAX_TRIALS
    left = dict(limits)
    while not progress.over:
        open_moves = (move for move in _moves(closures, best.growth, first) if move not in tried)
        move = next((move for move in open_moves if left[move.into]), None)
        if move is None:
            break
        tried.add(move)
        left[move.into] -= 1
        try:
            trial = _made(closures, best, move, progress)
        except KeyboardInterrupt:
            progress.interrupt()
            break
        if trial is None:
            continue
        found = cost(closures, trial.kept, trial.chi2)
        if found < best.cost * (1 - _LOWER):
            try:
                trial.grow()
            except KeyboardInterrupt:
                progress.interrupt()
            found = cost(closures, trial.kept, trial.chi2)
            gain = best.cost - found
            # The map that it replaces is the second hypothesis.
            best = Decided(trial, found, best.growth.kept, best.cost)
            # What was refused may be right beside the new map.
            tried = {move}
            if gain > _LARGE_GAIN * GATE[closures.graph.dof]:
                left = dict(limits)
        elif found < best.other_cost and (trial.kept != best.growth.kept).any():
            best = best._replace(other=trial.kept, other_cost=found)
    return best


def _made(closures: Closures, best: Decided, move: Move, progress: Progress) -> Growth | None:
    """Return the map after a move, grown if that can pay; None if it is not worth a look."""
    growth, few = best.growth, closures.few
    members = np.flatnonzero((growth.representative == move.group) & (growth.kept != move.into))
    progress.tell(f"trying {len(members)} loop closures {'in' if move.into else 'out'}")
    trial = growth.copy()
    if move.into:
        trial.believe(members, rough=True)
        before, rejected = int(growth.kept.sum()), ~trial.kept
        excess = cost(closures, trial.kept, trial.chi2) - best.cost
        if excess > of_run(closures, len(members)):
            return None
        trial.grow(everywhere=few)
        # A closure that only pays for itself may be false: others have to follow.
        others = int(trial.kept.sum()) - before - len(members)
        return trial if len(members) > 1 or others > 0 or not rejected.any() else None
    if int(np.count_nonzero(growth.candidates)) <= len(members):
        return None
    trial.disbelieve(members)
    if trial.count_likely() > len(members):
        trial.grow(everywhere=few)
    return trial


def _moves(closures: Closures, growth: Growth, first: Floats) -> Iterator[Move]:
    """Yield the moves that may lower the cost, the most likely first."""
    count, gate = len(closures), GATE[closures.graph.dof]
    group = growth.representative
    size = np.bincount(group, minlength=count)
    kept = np.bincount(group[growth.kept], minlength=count)
    rejected = size - kept
    # A true group is one that the trusted edges allow. With a map that it contradicts far beyond
    # its price, it fits only if another one is taken out first.
    allowed = np.bincount(group[first < _MAX_DRIFT * gate], minlength=count) * 2 > size
    nearest = np.full(count, np.inf)
    np.minimum.at(nearest, group, np.where(growth.kept, np.inf, growth.distance))
    near = nearest < _MAX_EXCESS * of_run(closures, np.maximum(rejected, 1))
    possible = np.flatnonzero((rejected > 0) & allowed & near)
    ratio = np.full(count, -np.inf)
    np.maximum.at(ratio, group, np.where(growth.kept, -np.inf, growth.log_ratio))
    for one in _sorted(possible, -rejected, -ratio):
        yield Move(True, one)
    blocked = ~growth.kept & growth.supported & (first < gate)
    if np.count_nonzero(blocked) < _MIN_BLOCKED:
        return
    chi2 = growth.chi2[closures.edges]
    excess = np.bincount(group, np.where(growth.kept, chi2 - closures.graph.dof, 0.0), count)
    # A group that was split, or that fits badly, is the most doubtful.
    for one in _sorted(np.flatnonzero((kept > 0) & (size > 1)), rejected == 0, -excess):
        yield Move(False, one)


def _sorted(groups: Ids, first: AnyArray, then: AnyArray) -> list[int]:
    order: list[int] = groups[np.lexsort((then[groups], first[groups]))].tolist()
    return order
