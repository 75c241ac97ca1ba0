"""Running a case: its starts, Gauss-Newton from each, and what came of it."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from time import perf_counter

from masat.errors import MasatError, MasatWarning
from masat.graph import PoseGraph
from masat.initializers import initialize
from masat.optimizers import Result, optimize
from masat.study.names import Case
from masat.study.worlds import GROUND_TRUTH, load_world
from masat.worlds import perturb

THRESHOLD = 1e-6
# Of chi2: a change no larger is rounding, up or down.
_ROUNDING = 1e-12


@dataclass(frozen=True)
class Trial:
    """A finished or failed run.

    Attributes
    ----------
    chi2 : tuple of float
        At the start and after each iteration; empty if the run failed.
    degrees_of_freedom : int
        Measured numbers less unknown ones.
    start_seconds, solve_seconds : float
        Wall time of the initial guess and of Gauss-Newton.
    error : str
        Why the run failed; empty if it did not.
    """

    case: Case
    start: str
    chi2: tuple[float, ...]
    degrees_of_freedom: int
    start_seconds: float
    solve_seconds: float
    error: str = ""

    def success(self, *, relative: bool = True) -> int | None:
        """Return the iteration at which chi2 stood still, or None.

        Relative: 0 <= (before - after) / after < 1e-6, as in g2o, where a rise within rounding
        counts as 0; absolute: the change is below 1e-6.
        """
        for k in range(1, len(self.chi2)):
            change = self.chi2[k - 1] - self.chi2[k]
            if relative:
                # An exact fit changes no more, and has no ratio.
                small = change < THRESHOLD * self.chi2[k] or change == 0
                still = change >= -_ROUNDING * self.chi2[k] and small
            else:
                still = abs(change) < THRESHOLD
            if still:
                return k
        return None

    def settled(self) -> int | None:
        """Return the iteration at which chi2 stood still up or down, or None.

        For real graphs, some of which fit exactly: chi2 then flickers by rounding, and may rise.
        """
        for k in range(1, len(self.chi2)):
            if abs(self.chi2[k - 1] - self.chi2[k]) < THRESHOLD * max(1.0, self.chi2[k]):
                return k
        return None


def instance(case: Case) -> PoseGraph:
    """Return the noisy graph of a case with the poses of the truth; a real graph as it is."""
    if not case.sigma:
        from masat.datasets import load

        with warnings.catch_warnings():
            warnings.simplefilter("ignore", MasatWarning)
            return load(case.world, indefinite="identity")
    return perturb(load_world(case.world), case.sigma, seed=case.seed)


def guess_of(graph: PoseGraph, start: str) -> PoseGraph:
    """Return the initial guess of a start."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MasatWarning)
        return initialize(graph, "given" if start == GROUND_TRUTH else start)


def solve(guess: PoseGraph, max_iterations: int) -> Result:
    """Run Gauss-Newton until chi2 changes by less than 1e-6.

    That is the stricter of the two thresholds: the history tells when the relative one was met.
    """
    return optimize(
        guess,
        "gauss_newton",
        max_iterations=max_iterations,
        relative_tolerance=0.0,
        absolute_tolerance=THRESHOLD * (1 - 1e-9),
    )


def run_case(case: Case, starts: tuple[str, ...], max_iterations: int) -> list[Trial]:
    """Run a case from each of the starts; a failure is a trial with its reason."""
    try:
        graph = instance(case)
    except (MasatError, OSError, MemoryError) as error:
        return [Trial(case, start, (), 0, 0.0, 0.0, _reason(error)) for start in starts]
    return [_run(case, graph, start, max_iterations) for start in starts]


def _run(case: Case, graph: PoseGraph, start: str, max_iterations: int) -> Trial:
    try:
        # What depends on the edges alone is built once a graph, not once a start.
        _ = graph.topology, graph.gauge
        begin = perf_counter()
        guess = guess_of(graph, start)
        guessed = perf_counter()
        result = solve(guess, max_iterations)
    except Exception as error:  # one bad run must not end the study
        return Trial(case, start, (), 0, 0.0, 0.0, _reason(error))
    return Trial(
        case=case,
        start=start,
        chi2=(result.initial_chi2, *(step.chi2 for step in result.history)),
        degrees_of_freedom=result.degrees_of_freedom,
        start_seconds=guessed - begin,
        solve_seconds=result.seconds,
    )


def _reason(error: BaseException) -> str:
    return f"{type(error).__name__}: {error}"
