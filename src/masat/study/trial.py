"""Running a case: Gauss-Newton from each initial guess, and what came of it."""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter

from masat.errors import MasatError
from masat.graph import PoseGraph
from masat.initializers import guess_of
from masat.optimizers import Result, optimize
from masat.study.names import Case
from masat.study.worlds import GROUND_TRUTH, load_real, load_world
from masat.worlds import perturb

THRESHOLD = 1e-6
"""Largest change of chi2 at convergence: relative, the default of g2o, or absolute."""

# A relative change of chi2 that is no larger is rounding, whether chi2 rises or falls.
_ROUNDING = 1e-11


@dataclass(frozen=True)
class Trial:
    """A finished or failed run.

    Attributes
    ----------
    case : Case
        The graph that was solved.
    init : str
        The initial guess.
    chi2 : tuple of float
        chi2 of the initial guess and after each iteration; empty if the run failed.
    degrees_of_freedom : int
        Number of measured coordinates minus the number of unknown ones.
    init_seconds, solve_seconds : float
        Wall time of the initial guess and of Gauss-Newton.
    error : str
        Why the run failed; empty if it did not.
    """

    case: Case
    init: str
    chi2: tuple[float, ...]
    degrees_of_freedom: int
    init_seconds: float
    solve_seconds: float
    error: str = ""

    @property
    def column(self) -> str:
        """What is compared: the initial guess."""
        return self.init

    @property
    def succeeded(self) -> bool:
        """Whether chi2 converged by the relative test."""
        return self.success() is not None

    def success(self, *, relative: bool = True) -> int | None:
        """Return the first iteration at which chi2 converged, or None.

        Relative: 0 <= (before - after) / after < 1e-6 as in g2o, where a rise within rounding
        counts as no change. Absolute: chi2 changes by less than 1e-6.
        """
        for k in range(1, len(self.chi2)):
            change = self.chi2[k - 1] - self.chi2[k]
            if relative:
                # Where chi2 is 0 the ratio is not defined, and the change is exactly 0.
                small = change < THRESHOLD * self.chi2[k] or change == 0
                converged = change >= -_ROUNDING * self.chi2[k] and small
            else:
                converged = abs(change) < THRESHOLD
            if converged:
                return k
        return None

    def convergence(self) -> int | None:
        """Return the first iteration that hardly changed chi2 in either direction, or None.

        This is the test for real graphs. Some of them fit exactly: their chi2 is all rounding and
        may rise.
        """
        for k in range(1, len(self.chi2)):
            if abs(self.chi2[k - 1] - self.chi2[k]) < THRESHOLD * max(1.0, self.chi2[k]):
                return k
        return None

    def reduced_chi2(self, iteration: int) -> float | None:
        """Return chi2 after an iteration over the degrees of freedom; None if there are none."""
        if self.degrees_of_freedom <= 0:
            return None
        return self.chi2[iteration] / self.degrees_of_freedom


def instance(case: Case) -> PoseGraph:
    """Return the noisy graph of a case with the true poses, or a real graph as it is."""
    if case.sigma:
        return perturb(load_world(case.world), case.sigma, seed=case.seed)
    return load_real(case.world)


def initial_guess(graph: PoseGraph, init: str) -> PoseGraph:
    """Return the graph at an initial guess, or at the poses it has: the truth."""
    # Not `masat.initialize`, whose warnings have no reader here.
    return guess_of(graph, "given" if init == GROUND_TRUTH else init)


def solve(guess: PoseGraph, max_iterations: int) -> Result:
    """Run Gauss-Newton until chi2 changes by less than 1e-6.

    This absolute threshold is the stricter one: the history tells when the relative one was met.
    """
    return optimize(
        guess,
        "gauss_newton",
        max_iterations=max_iterations,
        relative_tolerance=0.0,
        absolute_tolerance=THRESHOLD * (1 - 1e-9),
    )


def run_inits(case: Case, inits: tuple[str, ...], max_iterations: int) -> list[Trial]:
    """Run a case from each of the initial guesses; a failure is a trial with its reason."""
    try:
        graph = instance(case)
    except (MasatError, OSError, MemoryError) as error:
        return [Trial(case, init, (), 0, 0.0, 0.0, reason(error)) for init in inits]
    return [_run(case, graph, init, max_iterations) for init in inits]


def _run(case: Case, graph: PoseGraph, init: str, max_iterations: int) -> Trial:
    try:
        # What depends on the edges alone is built once per graph and belongs to no initial guess.
        _ = graph.topology, graph.gauge
        begin = perf_counter()
        guess = initial_guess(graph, init)
        guessed = perf_counter()
        result = solve(guess, max_iterations)
    except Exception as error:  # one failed run must not end the study
        return Trial(case, init, (), 0, 0.0, 0.0, reason(error))
    return Trial(
        case=case,
        init=init,
        chi2=(result.initial_chi2, *(step.chi2 for step in result.history)),
        degrees_of_freedom=result.degrees_of_freedom,
        init_seconds=guessed - begin,
        solve_seconds=result.seconds,
    )


def reason(error: BaseException) -> str:
    """Return why a run failed."""
    return f"{type(error).__name__}: {error}"
