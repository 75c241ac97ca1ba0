"""Groups of closures are tried in a map, or taken out of it, where that lowers the cost."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from masat.arrays import AnyArray, Flags, Floats, Ids
from masat.progress import Progress
from masat.quantiles import GATE
from masat.redundancy import whitened
from masat.robust.closures import Closures
from masat.robust.growth import Growth
from masat.robust.objective import cost, of_run

# Trials after which no other is made: of adding and of taking out; where closures are few, each
# counts, and a trial costs little.
_MAX_TRIALS = {True: 3, False: 4}
_MAX_TRIALS_OF_FEW = {True: 8, False: 4}
# It takes as many plausible closures that are rejected to doubt kept ones.
_MIN_BLOCKED = 5
# Squared distance, in prices of a group, beyond which adding it is not tried; and in gates, beyond
# which the trusted edges alone exclude it.
_MAX_EXCESS, _MAX_DRIFT = 10.0, 10.0
# Fraction by which a move has to lower the cost, and gates after which others get a new chance.
_LOWER, _LARGE_GAIN = 1e-6, 2.0
# What the rest leaves of the covariance of a group, at least, as a fraction of it.
_LEAST_LEFT = 0.1
# chi2 of the kept closures, as a multiple of what it should be, above which none is suspected more.
_MAX_MISFIT = 1.2


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
    moves = _moves(closures, growth, first)
    while not progress.over:
        move = next((move for move in moves if move not in tried and left[move.into]), None)
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
            larger = trial.copy()
            try:
                larger.grow()
            except KeyboardInterrupt:
                progress.interrupt()
            of_larger = cost(closures, larger.kept, larger.chi2)
            if of_larger <= found:
                trial, found = larger, of_larger
            gain = best.cost - found
            # The map that it replaces is the second hypothesis.
            best = Decided(trial, found, best.growth.kept, best.cost)
            # What was refused may be right beside the new map.
            tried = {move}
            moves = _moves(closures, trial, first)
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
    doubtful = np.flatnonzero((kept > 0) & (size > 1))
    # A group of which a part is rejected is doubtful as well.
    split = _sorted(doubtful, rejected == 0, -excess)
    contradiction = _contradiction(closures, growth)
    contradicted = split if contradiction is None else _sorted(doubtful, -contradiction)
    for pair in zip(contradicted, split, strict=True):
        yield from (Move(False, one) for one in pair)


def _contradiction(closures: Closures, growth: Growth) -> Floats | None:
    """Return how far the rest of the map contradicts the kept closures of each group, (c,).

    None where all closures contradict each other: their information is too large.

    The mean over the members of what chi2 would fall by without the group, less what it falls by
    where all are true. A group counts as one closure with the information of all: its members have
    the same errors, as a rule, so that compared one by one they confirm each other. Source: Baarda,
    A testing procedure for use in geodetic networks, 1968, with several outliers at once.
    """
    members = np.flatnonzero(growth.kept)
    group, count = growth.representative[members], len(closures)
    checked = whitened(growth.map, growth.equations)
    edges = np.flatnonzero(closures.kept_edges(growth.kept))
    at = np.searchsorted(edges, closures.edges[members])
    residuals, left = checked.residuals[at], checked.left[at]
    if np.square(residuals).sum() > _MAX_MISFIT * np.einsum("kii->", left):
        return None
    covered, axes = np.linalg.eigh(np.eye(closures.graph.dof) - left)
    along = np.einsum("kji,kj->ki", axes, residuals)
    size = np.bincount(group, minlength=count)
    own = 1 / size[group][:, None]
    rest = np.maximum(own - covered, _LEAST_LEFT * own)
    surplus = ((np.square(along) - (1 - covered)) / rest).sum(axis=1)
    return np.asarray(np.bincount(group, surplus, count) / np.maximum(size, 1))


def _sorted(groups: Ids, *keys: AnyArray) -> list[int]:
    order: list[int] = groups[np.lexsort([key[groups] for key in reversed(keys)])].tolist()
    return order
