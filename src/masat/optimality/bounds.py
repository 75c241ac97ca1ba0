"""Lower bounds on chi2 over all poses."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from masat.arrays import Floats, Indices
from masat.errors import InitializationError, OptimizationError
from masat.graph import PoseGraph
from masat.optimality.relaxation import Relaxation
from masat.optimality.surrogates import tangent_surrogate

# A gap below this fraction of chi2 counts as none: minima that differ by less are one.
TIGHT = 1e-6
# Fractions of chi2 that a bound may give up, from the smallest on, until the certificate holds.
_ALLOWED = (0.0, TIGHT / 4, 1e-4, 1e-3, 1e-2, 0.1, 0.5)
# And what one at a higher rank may, whose certificate fails by less.
_ALLOWED_LIFTED = (0.0, TIGHT / 4, 2e-6, 1e-5, *_ALLOWED[2:])
_LIFTED_DECREASE = 1e-9


def chi2_bound(graph: PoseGraph, chi2: float) -> float:
    """Return a number that chi2 of no poses lies below, from the certificate at a graph's poses.

    The surrogate that touches chi2 at the poses (`surrogates.tangent_surrogate`) exceeds chi2
    nowhere. With S the matrix of its Lagrangian and g its gradient at the poses, no poses cost less
    than these by more than <g, S^-1 g> if S is positive definite; a shift of S that makes it so
    adds four times itself for each rotation in 2D, and for each row of one in 3D. At a minimum of
    chi2 g is zero, so that a positive definite S proves the minimum global. One factorization where
    S is positive definite, up to seven where it is not.

    Parameters
    ----------
    graph : PoseGraph
        A graph with poses, best at a minimum.
    chi2 : float
        Its chi2.

    Returns
    -------
    float
        Between 0, which chi2 never lies below, and `chi2`.

    Raises
    ------
    OptimizationError
        If an information matrix is singular to rounding.
    """
    return TangentRelaxation(graph, chi2).bound(_ALLOWED)


def certified_gap(graph: PoseGraph, chi2: float) -> float:
    """Return how far the certificate, if it holds, leaves chi2 of a graph's poses above the lowest.

    As a fraction of chi2, and 1 where it does not hold. Near a global minimum, where an optimizer
    stopped early, the certificate mostly holds with a gap.
    """
    try:
        bound = TangentRelaxation(graph, chi2).bound((0.0,))
    except OptimizationError:
        return 1.0
    return (chi2 - bound) / chi2 if chi2 > bound else 0.0


def doubtful_nodes(graph: PoseGraph) -> Indices:
    """Return indices of nodes of which one or more move wherever chi2 is lower than at a minimum.

    With them fixed the certificate holds. There are none where it holds for the whole graph, and
    all are doubtful where no surrogate touches chi2 at the graph's poses.
    """
    assert graph.poses is not None
    everywhere = np.arange(len(graph.ids), dtype=np.int32)
    try:
        surrogate = tangent_surrogate(graph, graph.poses)
    except OptimizationError:
        return everywhere
    if surrogate.deficit > TIGHT * graph.chi2:
        return everywhere
    return Relaxation(graph, surrogate).doubtful_nodes(graph.poses)


def lifted_bound(graph: PoseGraph, chi2: float, *, seed: int = 0) -> tuple[float, PoseGraph | None]:
    """Return a bound from a higher rank, and the graph at the poses that this rank is rounded to.

    The minimum of the tangent surrogate at a higher rank lies below all poses' chi2, and its
    certificate fails by less. Costs a descent at that rank. Arguments as of `chi2_bound`; the graph
    is None where memory does not allow the higher rank.
    """
    relaxation = TangentRelaxation(graph, chi2)
    try:
        lifted = relaxation.lifted(seed)
    except InitializationError:
        return 0.0, None
    return (0.0, None) if lifted is None else (lifted.bound, relaxation.rounded(lifted.unknowns))


class Lifted(NamedTuple):
    """The minimum of a surrogate at a higher rank.

    Attributes
    ----------
    bound : float
        A bound on chi2.
    unknowns : ndarray, (n, 4, p)
        Those of the relaxation there.
    """

    bound: float
    unknowns: Floats


class TangentRelaxation:
    """The relaxation of the surrogate that touches chi2 at a graph's poses."""

    def __init__(self, graph: PoseGraph, chi2: float) -> None:
        if graph.poses is None:
            raise OptimizationError("the graph has no poses: there is nothing to bound")
        self._graph = graph
        surrogate = tangent_surrogate(graph, graph.poses)
        self._chi2, self._touched = chi2, chi2 - surrogate.deficit
        self._relaxation = Relaxation(graph, surrogate)
        self._unknowns = self._relaxation.unknowns(graph.poses)

    def bound(self, allowed: tuple[float, ...]) -> float:
        """Return a bound that gives up one of some fractions of chi2, the first that holds."""
        return self._touched_less(self._unknowns, 0.0, allowed)

    def lifted(self, seed: int, allowed: tuple[float, ...] = _ALLOWED_LIFTED) -> Lifted | None:
        """Return the minimum at a higher rank, or None where memory does not allow that."""
        relaxation = self._relaxation
        if not relaxation.can_lift():
            return None
        top = relaxation.minimize_lifted(self._unknowns, decrease=_LIFTED_DECREASE, seed=seed)
        below = relaxation.cost(self._unknowns) - top.cost
        return Lifted(self._touched_less(top.unknowns, below, allowed), top.unknowns)

    def rounded(self, unknowns: Floats) -> PoseGraph | None:
        """Return the graph at the poses nearest to unknowns, or None if they are not finite."""
        try:
            return self._graph.with_poses(self._relaxation.poses(unknowns))
        except InitializationError:
            return None

    def _touched_less(self, x: Floats, below: float, allowed: tuple[float, ...]) -> float:
        """Return the best bound that unknowns give whose cost lies that far below the poses'."""
        best = 0.0
        for fraction in allowed:
            gap = self._relaxation.gap(x, fraction * self._chi2)
            if np.isfinite(gap):
                best = max(best, self._touched - below - gap)
                # A certificate that hardly holds may have a large gap: more allowance is less.
                if gap <= 2 * max(fraction, TIGHT / 4) * self._chi2:
                    break
        return float(np.clip(best, 0.0, self._chi2))
