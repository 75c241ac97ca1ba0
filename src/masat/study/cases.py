"""Running a case, whatever is compared in it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

from masat.study.closure_trial import ClosureTrial, run_methods
from masat.study.names import Case
from masat.study.trial import Trial, run_inits

AnyTrial: TypeAlias = Trial | ClosureTrial
"""A run of an initial guess, or of a method against false loop closures."""


def run_case(case: Case, columns: tuple[str, ...], max_iterations: int) -> Sequence[AnyTrial]:
    """Run a case; a failure is a trial with its reason.

    Parameters
    ----------
    case : Case
        The graph.
    columns : tuple of str
        Initial guesses or, if the case has false loop closures, methods against these.
    max_iterations : int
        Largest number of iterations of an optimization.
    """
    if case.kind:
        return run_methods(case, columns, max_iterations)
    return run_inits(case, columns, max_iterations)
