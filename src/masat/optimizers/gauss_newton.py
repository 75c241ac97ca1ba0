"""The Gauss-Newton method."""

from __future__ import annotations

from time import perf_counter
from typing import Any

import numpy as np

from masat.optimizers.damped import DampedSystem, damped
from masat.optimizers.equations import Equations
from masat.optimizers.termination import (
    Iteration,
    Outcome,
    Report,
    StopReason,
    Termination,
)


def gauss_newton(
    equations: Equations | DampedSystem[Any],
    poses: Any,
    termination: Termination,
    report: Report,
) -> Outcome:
    """Solve H step = J' W (-e) and take the full step, until chi2 no longer changes.

    Fast near a minimum; far from one chi2 may rise, oscillate or diverge. Source: Nocedal and
    Wright, Numerical Optimization, 2006, section 10.3; stopping as in g2o.
    """
    start = perf_counter()
    system = damped(equations, poses)
    chi2 = system.linearize(poses)
    best = Outcome(poses, chi2, StopReason.MAX_ITERATIONS)
    for _ in range(termination.max_iterations):
        if termination.flat(system.steepest):
            return Outcome(poses, chi2, StopReason.GRADIENT)
        solved = system.damped_step(0.0)
        if isinstance(solved, int):
            return best._replace(reason=StopReason.SINGULAR, singular_node=solved)
        poses = system.retract(poses, solved.step)
        before, chi2 = chi2, system.linearize(poses)
        if not np.isfinite(chi2):
            return best._replace(reason=StopReason.DIVERGED)
        if chi2 < best.chi2:
            best = Outcome(poses, chi2, StopReason.MAX_ITERATIONS)
        stop = report(Iteration(chi2, solved.length(), 0.0, perf_counter() - start))
        if reason := termination.change(before, chi2):
            return Outcome(poses, chi2, reason)
        if stop is True:
            return best._replace(reason=StopReason.INTERRUPTED)
    return best
