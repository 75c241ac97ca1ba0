"""A hypothesis which closures are true, with information of one scale or another."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from masat.arrays import Flags, Floats
from masat.errors import InitializationError, OptimizationError
from masat.graph import PoseGraph
from masat.progress import Progress
from masat.robust.closures import QUARTILE, Closures
from masat.robust.growth import Growth
from masat.robust.moves import Decided, improve
from masat.robust.objective import cost
from masat.robust.prediction import agreement
from masat.robust.redundancy import Redundancy, Scales, redundancy

# The information is rescaled where it seems off by more than these factors, at most by the last
# at once. What is too precise loses the closures that would show by how much; what is cautious may
# be so because of a few large errors.
_MAX_CAUTION, _MAX_PROMISE, _MAX_FACTOR = 20.0, 2.0, 100.0
_MIN_KEPT, _MAX_SCALES = 10, 5
# Closures are rescaled as well where their scale is so much below that of the trusted edges; and
# once rescaled, until the scales are right to the second factor.
_MAX_RATIO, _CONVERGED = 5.0, 1.5


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A map that grew with information of some scale.

    Attributes
    ----------
    closures : Closures
        The closures, of the graph with the scaled information.
    used : Scales
        The factors of the covariances, which are 1 at first.
    decided : Decided
        The map, its cost, and the second hypothesis.
    first : ndarray, (c,)
        Squared distances of the closures from what the trusted edges alone predict.
    checks : Redundancy
        What the edges of the map say of each other.
    alone : float
        chi2 of the trusted edges in a map of their own.
    """

    closures: Closures
    used: Scales
    decided: Decided
    first: Floats
    checks: Redundancy
    alone: float

    @property
    def growth(self) -> Growth:
        """The map."""
        return self.decided.growth

    @property
    def cost(self) -> float:
        """The cost of the decision, with the likelihood of the scaled information."""
        return self.decided.cost + self.price_of_scales

    @property
    def price_of_scales(self) -> float:
        """What wider covariances take from the likelihood, as far as the edges are checked."""
        trusted = self.closures.trusted[self.closures.kept_edges(self.growth.kept)]
        numbers = self.checks.redundancy_numbers
        of_trusted, of_closures = (float(np.log(scale or 1.0)) for scale in self.used)
        return float(numbers[trusted].sum() * of_trusted + numbers[~trusted].sum() * of_closures)

    @property
    def scales(self) -> Scales:
        """What the map says of the scales of the information as given."""
        found = self.checks.scales(
            self.closures.trusted[self.closures.kept_edges(self.growth.kept)]
        )
        of_trusted, of_closures = (
            None if now is None else now * (used or 1.0)
            for now, used in zip(found, self.used, strict=True)
        )
        return Scales(of_trusted, of_closures)


def grown(graph: PoseGraph, trusted: Flags, used: Scales, progress: Progress) -> Hypothesis:
    """Grow a map with scaled information, and improve it."""
    of_trusted, of_closures = (scale or 1.0 for scale in used)
    if (of_trusted, of_closures) != (1.0, 1.0):
        factors = np.where(trusted, of_trusted, of_closures)
        graph = replace(graph, information=graph.information / factors[:, None, None])
    closures = Closures(graph, trusted)
    growth = Growth(closures, progress)
    first, alone = growth.distance.copy(), growth.map.chi2
    decided = Decided(growth, cost(closures, growth.kept, growth.chi2), None, np.inf)
    try:
        growth.grow(thorough=True)
        decided = improve(closures, growth, first, progress)
        decided.growth.finish()
    except KeyboardInterrupt:
        progress.interrupt()
    growth = decided.growth
    decided = decided._replace(cost=cost(closures, growth.kept, growth.chi2))
    return Hypothesis(
        closures, used, decided, first, redundancy(growth.map, growth.equations), alone
    )


def best_scaled(graph: PoseGraph, trusted: Flags, progress: Progress) -> Hypothesis:
    """Return the hypothesis of the lowest cost, with the information as it is and rescaled."""
    best = last = grown(graph, trusted, Scales(1.0, 1.0), progress)
    for _ in range(_MAX_SCALES):
        used = _better_scales(last)
        if used is None or progress.over:
            break
        progress.tell(
            f"trying {used.trusted:.3g} and {used.closures:.3g} times the covariances of the "
            "trusted edges and the closures"
        )
        try:
            last = grown(graph, trusted, used, progress)
        except KeyboardInterrupt:
            progress.interrupt()
            break
        except (OptimizationError, InitializationError):
            break
        best = min(best, last, key=lambda hypothesis: hypothesis.cost)
    return best


def _better_scales(hypothesis: Hypothesis) -> Scales | None:
    """Return scales of the information that fit a hypothesis better, or None if its own do."""
    closures, kept = hypothesis.closures, hypothesis.growth.kept
    trusted = closures.trusted[closures.kept_edges(kept)]
    found = hypothesis.checks.scales(trusted)
    if int(kept.sum()) < _MIN_KEPT:
        # Perhaps since all information is too large. Pairs of one place tell.
        pairs = closures.pairs
        if len(pairs) < _MIN_KEPT or hypothesis.used != (1.0, 1.0):
            return None
        between = agreement(closures, hypothesis.growth.poses, pairs)
        common = float(np.quantile(between, 0.25)) / QUARTILE[closures.graph.dof]
        found = Scales(common, common) if common > _MAX_RATIO else Scales(None, None)
    factors = _factors(found, hypothesis.used)
    if factors == (1.0, 1.0):
        return None
    of_trusted, of_closures = (
        (used or 1.0) * factor for used, factor in zip(hypothesis.used, factors, strict=True)
    )
    return Scales(of_trusted, of_closures)


def _factors(found: Scales, used: Scales) -> tuple[float, float]:
    """Return the factors by which to change the scales of the trusted edges and the closures."""
    trusted, closures = (scale or 1.0 for scale in found)
    lowest, highest = 1 / _MAX_CAUTION, _MAX_PROMISE
    if used != (1.0, 1.0):
        lowest, highest = 1 / _CONVERGED, _CONVERGED
    both = found.trusted is not None and found.closures is not None
    if both and closures < trusted / _MAX_RATIO:
        lowest = trusted / _MAX_RATIO
    factors = [1.0, 1.0]
    if not lowest < closures < highest:
        # The gate has cut off what would make a large scale larger.
        factors[1] = closures**2 if closures > highest and closures > _MAX_PROMISE else closures
    if not lowest < trusted < highest and (trusted > highest or not both or factors[1] != 1.0):
        factors[0] = trusted
    trusted, closures = np.clip(factors, 1 / _MAX_FACTOR, _MAX_FACTOR).tolist()
    return trusted, closures
