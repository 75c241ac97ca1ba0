"""The best minimum that can be found from a guess."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from typing import NamedTuple, TypeAlias

from masat import _core
from masat.arrays import Floats
from masat.assembly import AssembledGraph
from masat.errors import InitializationError, OptimizationError
from masat.graph import PoseGraph
from masat.optimality.bounds import TIGHT, certified_gap
from masat.optimality.cycles import AmbiguousCycles, rotation_residuals, rotation_weight
from masat.optimality.relaxation import Relaxation
from masat.optimality.search import exact_minimum, lower_minimum
from masat.optimizers import Iteration, Result, optimize
from masat.optimizers.equations import Equations, normal_equations
from masat.optimizers.projection import ProjectedEquations
from masat.optimizers.translations import BestTranslations
from masat.outliers import cannot_be_right, describe_outliers
from masat.progress import Progress

# Gauss-Newton that needs more iterations than this is as likely as not to end in a minimum that is
# wrong in many parts of the graph.
_FEW_ITERATIONS = 15
# So is one whose chi2 rises so often; the first steps from the chordal guess mostly go too far.
_MOST_RISES = 2
# Changes of chi2 below this fraction are near enough to a minimum for the check and for the search.
_FIRST_TOLERANCE = 1e-4
# The gap, as a fraction of chi2, that a certificate may have there.
_NEAR_MINIMUM = 1e-3
# After so many iterations chi2 of a graph without false edges is no more too large by this factor.
_PATIENCE, _STRICTNESS = 3, 10.0
# Operations of a factorization above which not even these iterations are made: some seconds on one
# core. On public graphs and simulated worlds the chordal guess itself is good enough for the test.
_EXPENSIVE = 1e10
# Operations that a search may take in a graph that cannot be right, and those that all other
# initial guesses may: about a second on one core. Where a search follows, which takes longer than
# they do, the guesses may take more.
_AFFORDABLE, _AFFORDABLE_BEFORE_SEARCH = 5e9, 1.5e11
# Trials of a search for each edge, iterations of a trial, and operations that take as long as what
# Python and NumPy do in an iteration.
_TRIALS_PER_EDGE, _ITERATIONS, _OVERHEAD = 4, 15, 3e5
# No ambiguous cycles are sought, which takes as long as the chordal certificate, where rotation
# residuals are below this, in radians, and the graph is either well connected (edges over nodes) or
# all its edges together turn by less than this standard deviation: a long loop has small residuals.
_SMALL_ROTATION, _WELL_CONNECTED, _SMALL_DRIFT = 0.1, 1.3, 1.0


# Limits of the optimization of another initial guess.
_START_ITERATIONS, _START_TOLERANCE = 60, 1e-6

Start: TypeAlias = Callable[[PoseGraph], PoseGraph]


class Minimum(NamedTuple):
    """The lowest minimum that a search found.

    Attributes
    ----------
    poses : ndarray, (n, 3) or (n, 7)
    first_is_plausible : bool
        Whether the minimum to which the guess led at once looked global.
    notes : tuple of str
        What the user should know.
    """

    poses: Floats
    first_is_plausible: bool
    notes: tuple[str, ...] = ()


def best_minimum(
    guess: PoseGraph,
    *,
    starts: Sequence[Start] = (),
    seed: int = 0,
    progress: Progress | None = None,
    equations: _core.NormalEquations | None = None,
) -> Minimum:
    """Optimize a guess, check whether the minimum looks global, and search on where it does not.

    Gauss-Newton leads to a first minimum, or the dogleg method where that takes many iterations. If
    chi2 itself is certified, or the certificate of the chordal cost fails by little, the search
    ends. If not, `lower_minimum` searches around the doubtful parts.

    In 3D the search also takes parts of the minima near other initial guesses, `starts`.

    Where chi2 is so large that no local minimum explains it (`outliers.cannot_be_right`), the graph
    has false edges, or its information is far too large. There is no search then unless it is
    cheap; the other initial guesses are tried where that is cheap; and the minimum may not be quite
    reached.

    Parameters
    ----------
    guess : PoseGraph
        A graph with poses.
    starts : sequence of callable
        Other initial guesses of a graph, each a function from the graph to the graph with poses.
    seed : int
        Seed of the random noise that is added when a rank is raised.
    progress : Progress, optional
        What reports the stages and limits the time.
    equations : NormalEquations, optional
        Those of the graph, to be used again.

    Returns
    -------
    Minimum

    Raises
    ------
    InitializationError
        If the graph cannot be optimized.
    """
    progress = progress or Progress()
    equations = normal_equations(guess) if equations is None else equations
    try:
        if guess.elimination.operations(guess.dof) > _EXPENSIVE and cannot_be_right(
            guess, equations.chi2(_poses(guess)), strictness=_STRICTNESS
        ):
            return _without_search(guess, progress)
        is_small = _search_operations(guess) <= _AFFORDABLE
        near = _first_minimum(guess, equations, progress, stop_if_wrong=not is_small)
        is_wrong = not progress.over and cannot_be_right(near.graph, near.chi2)
        minima = [near]
        if is_wrong:
            minima = _minima(near, starts, _AFFORDABLE, equations, progress)
            near = minima[0]
            if not is_small:
                return _without_search(near.graph, progress)
        try:
            there = None if progress.over else _global_minimum(near, equations, progress)
            if there is not None:
                return Minimum(there.poses, True)
        except KeyboardInterrupt:
            progress.interrupt()
        doubts = describe_outliers(near.graph, "searched")
        if progress.over:
            return Minimum(near.poses, False, doubts)
        for doubt in doubts:
            progress.tell(doubt, near.chi2, warning=True)
        try:
            if guess.dimension == 3 and not is_wrong:
                limit = _AFFORDABLE_BEFORE_SEARCH
                minima = _minima(near, starts, limit, equations, progress)
            found = lower_minimum(
                minima[0].graph,
                seed=seed,
                progress=progress,
                equations=equations,
                others=[minimum.poses for minimum in minima[1:]],
            )
        except KeyboardInterrupt:
            progress.interrupt()
            return Minimum(near.poses, False, doubts)
        except InitializationError:
            # The chordal problem may leave open what chi2 determines, as roll and pitch by heights.
            if not isinstance(guess, AssembledGraph):
                raise
            return Minimum(near.poses, False, doubts)
    except OptimizationError as error:
        raise InitializationError(f"the guess has to be optimized first: {error}") from error
    return Minimum(found.poses, False, describe_outliers(found.graph, "searched"))


def _without_search(graph: PoseGraph, progress: Progress) -> Minimum:
    """Return the poses of a graph whose false edges make a search useless."""
    doubts = describe_outliers(graph, "searched")
    for doubt in doubts:
        progress.tell(doubt, graph.chi2, warning=True)
    return Minimum(_poses(graph), False, doubts)


def _poses(graph: PoseGraph) -> Floats:
    if graph.poses is None:
        raise InitializationError("the guess has no poses")
    return graph.poses


def _global_minimum(
    near: Result, equations: _core.NormalEquations, progress: Progress
) -> Result | None:
    """Return the minimum near which an optimizer stopped early, if it looks global.

    Either the certificate of chi2 holds, or no cycle is ambiguous and the chordal one fails by
    little.
    """
    gap = certified_gap(near.graph, near.chi2)
    if gap <= TIGHT:
        return near
    if gap <= _NEAR_MINIMUM or (
        Relaxation(near.graph).plausible(near.poses) and not _may_be_ambiguous(near)
    ):
        return exact_minimum(near.graph, equations, progress)
    return None


def _may_be_ambiguous(near: Result) -> bool:
    """Whether a cycle may close with another multiple of 2 pi; cheap where rotations fit well."""
    graph = near.graph
    angles = rotation_residuals(graph, near.poses)[0]
    measured = graph.information[:, graph.dimension, graph.dimension] > 0
    if angles[measured].max(initial=0.0) < _SMALL_ROTATION:
        drift = float((1 / rotation_weight(graph)[measured]).sum()) ** 0.5
        if len(graph.edges) > _WELL_CONNECTED * len(graph.ids) or drift < _SMALL_DRIFT:
            return False
    return len(AmbiguousCycles(near.graph).edges(near.poses)) > 0


def _search_operations(graph: PoseGraph) -> float:
    """Return about how many operations a search takes, those of Python and NumPy included."""
    trials = _TRIALS_PER_EDGE * len(graph.edges)
    return trials * _ITERATIONS * (graph.elimination.operations(graph.dof) + _OVERHEAD)


def _minima(
    near: Result,
    starts: Sequence[Start],
    limit: float,
    equations: _core.NormalEquations,
    progress: Progress,
) -> list[Result]:
    """Return a minimum and those near other initial guesses of its graph, the lowest first."""
    graph, minima = near.graph, [near]
    each = _START_ITERATIONS * (graph.elimination.operations(graph.dof) + _OVERHEAD)
    if len(starts) * each > limit:
        return minima
    for start in starts:
        if progress.over:
            break
        progress.tell("optimizing another initial guess", near.chi2)
        try:
            minima.append(
                optimize(
                    start(graph),
                    max_iterations=_START_ITERATIONS,
                    relative_tolerance=_START_TOLERANCE,
                    equations=equations,
                    progress=progress,
                )
            )
        except (InitializationError, OptimizationError):
            continue
        except KeyboardInterrupt:
            progress.interrupt()
    return sorted(minima, key=lambda minimum: minimum.chi2)


def _first_minimum(
    guess: PoseGraph,
    equations: _core.NormalEquations,
    progress: Progress,
    stop_if_wrong: bool,
) -> Result:
    """Return a minimum near a guess, in a safer way where few iterations find none."""
    run = partial(optimize, relative_tolerance=_FIRST_TOLERANCE, progress=progress)
    progress.tell("optimizing the chordal guess")
    watch = _Watch(guess, equations.chi2(_poses(guess)), stop_if_wrong)
    quick = run(
        guess, "gauss_newton", max_iterations=_FEW_ITERATIONS, report=watch, equations=equations
    )
    if quick.converged or progress.over or watch.is_wrong:
        return quick
    # In 3D projected steps lead to higher minima.
    own: Equations = equations
    if guess.dimension == 2:
        with suppress(InitializationError):
            own = ProjectedEquations(equations, BestTranslations(guess))
    # Gauss-Newton may have ended anywhere, even where chi2 is not finite.
    safe = run(guess, "dogleg", equations=own)
    return min(safe, quick, key=lambda minimum: minimum.chi2)


class _Watch:
    """Stops Gauss-Newton where it rises again, or where the map cannot become right."""

    def __init__(self, graph: PoseGraph, chi2: float, stop_if_wrong: bool) -> None:
        self._graph, self._lowest, self._last, self._iterations = graph, chi2, chi2, 0
        self._rises, self._judges = 0, stop_if_wrong
        self.is_wrong = False

    def __call__(self, step: Iteration) -> bool:
        """Return whether to stop after an iteration."""
        self._iterations += 1
        # Not less than or equal: what is not a number rises, too.
        self._rises += not step.chi2 <= self._last
        self._last, self._lowest = step.chi2, min(self._lowest, step.chi2)
        if self._judges and self._iterations == _PATIENCE:
            self.is_wrong = cannot_be_right(self._graph, self._lowest, strictness=_STRICTNESS)
        return self.is_wrong or (self._iterations >= _PATIENCE and self._rises >= _MOST_RISES)
