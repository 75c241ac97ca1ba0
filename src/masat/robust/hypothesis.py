"""A hypothesis which closures are true, with information of one scale or another."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from masat.arrays import Flags, Floats
from masat.errors import InitializationError, OptimizationError
from masat.graph import PoseGraph
from masat.neighbors import scale_of_best_tenth
from masat.optimizers import optimize
from masat.progress import Progress
from masat.residuals import chi2_per_edge
from masat.robust.closures import Closures
from masat.robust.growth import Growth
from masat.robust.moves import Decided, improve
from masat.robust.objective import cost
from masat.robust.prediction import agreement
from masat.robust.scales import Redundancy, Scales, redundancy

# The information is rescaled where it seems off by more than these factors, at most by the last
# at once. What is too precise loses the closures that would show by how much; what is cautious may
# be so because of a few large errors.
_MAX_CAUTION, _MAX_PROMISE, _MAX_FACTOR = 20.0, 2.0, 100.0
_MIN_KEPT, _MAX_SCALES = 10, 5
# A hypothesis explains the closures that another one rejects if it keeps so many times as many, so
# large a fraction of those that others support, and its own scales are right to the last factor.
_MANY_TIMES, _MIN_EXPLAINED, _FITTING = 2, 0.3, 3.0
# Scale of the best tenth of the pairs above which all information seems too large.
_MIN_COMMON = 2.0
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
    def found(self) -> Scales:
        """What the map says of the scales of the information with which it was made."""
        trusted = self.closures.trusted[self.closures.kept_edges(self.growth.kept)]
        return self.checks.scales(trusted)

    @property
    def scales(self) -> Scales:
        """What the map says of the scales of the information as given."""
        of_trusted, of_closures = (
            None if now is None else now * (used or 1.0)
            for now, used in zip(self.found, self.used, strict=True)
        )
        return Scales(of_trusted, of_closures)


def grown(
    graph: PoseGraph,
    trusted: Flags,
    used: Scales,
    progress: Progress,
    threads: int | None = None,
    believed: Flags | None = None,
) -> Hypothesis:
    """Grow a map with scaled information, perhaps from edges already believed, and improve it."""
    of_trusted, of_closures = (scale or 1.0 for scale in used)
    if (of_trusted, of_closures) != (1.0, 1.0):
        factors = np.where(trusted, of_trusted, of_closures)
        graph = replace(graph, information=graph.information / factors[:, None, None])
    closures = Closures(graph, trusted, threads)
    growth = Growth(closures, progress)
    first, alone = growth.distance.copy(), growth.map.chi2
    try:
        if believed is not None:
            growth.begin_with(np.flatnonzero(believed[closures.edges]))
        growth.grow(thorough=True)
    except KeyboardInterrupt:
        progress.interrupt()
    decided = improve(closures, growth, first, progress)
    growth = decided.growth
    if not progress.over:
        try:
            growth.finish()
        except KeyboardInterrupt:
            progress.interrupt()
    decided = decided._replace(cost=cost(closures, growth.kept, growth.chi2))
    return Hypothesis(
        closures, used, decided, first, redundancy(growth.map, growth.equations), alone
    )


def best_scaled(
    graph: PoseGraph,
    trusted: Flags,
    progress: Progress,
    threads: int | None = None,
    believed: Flags | None = None,
) -> Hypothesis:
    """Return the hypothesis of the lowest cost, with the information as it is and rescaled."""
    best = last = grown(graph, trusted, Scales(1.0, 1.0), progress, threads, believed)
    for _ in range(_MAX_SCALES):
        used = _better_scales(last)
        if used is None or progress.over:
            break
        progress.tell(
            f"trying {used.trusted:.3g} and {used.closures:.3g} times the covariances of the "
            "trusted edges and the closures"
        )
        try:
            last = grown(graph, trusted, used, progress, threads)
        except KeyboardInterrupt:
            progress.interrupt()
            break
        except (OptimizationError, InitializationError):
            break
        if last.cost < best.cost or _explains(last, best):
            best = last
    return best


def _explains(last: Hypothesis, best: Hypothesis) -> bool:
    """Return whether information of another scale explains closures that are rejected without it.

    Their costs do not compare then, since rejected closures cost the same at any scale. What is
    compared is the cost of both under the same information, that of the last hypothesis.
    """
    closures, kept = last.closures, last.growth.kept
    few = int(best.growth.kept.sum()) * _MANY_TIMES
    if int(kept.sum()) < max(_MIN_KEPT, few, _MIN_EXPLAINED * last.growth.supported.sum()):
        return False
    if any(scale is not None and not 1 / _FITTING < scale < _FITTING for scale in last.found):
        return False
    graph = closures.graph_with(best.growth.kept, best.growth.poses)
    other = chi2_per_edge(closures.graph, optimize(graph, "dogleg").poses)
    return last.decided.cost < cost(closures, best.growth.kept, other)


def _better_scales(hypothesis: Hypothesis) -> Scales | None:
    """Return scales of the information that fit a hypothesis better, or None if its own do."""
    closures, kept = hypothesis.closures, hypothesis.growth.kept
    found = hypothesis.found
    supported = int(hypothesis.growth.supported.sum())
    right = None not in found and max(scale or 1.0 for scale in found) < _CONVERGED
    if not right and int(kept.sum()) < max(_MIN_KEPT, _MIN_EXPLAINED * supported):
        # Perhaps since all information is too large. Pairs of one place tell.
        pairs = closures.pairs
        if len(pairs) < _MIN_KEPT or hypothesis.used != (1.0, 1.0):
            return None
        between = agreement(closures, hypothesis.growth.poses, pairs)
        common = scale_of_best_tenth(between, closures.graph.dof)
        if common > _MIN_COMMON:
            found = Scales(common, common)
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
