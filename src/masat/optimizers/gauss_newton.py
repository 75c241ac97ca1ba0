"""The Gauss-Newton method."""

from __future__ import annotations

from time import perf_counter

import numpy as np

from masat.arrays import Floats
from masat.optimizers.equations import Equations
from masat.optimizers.termination import (
    Iteration,
    Outcome,
    Report,
    StopReason,
    Termination,
    length,
)


def gauss_newton(
    equations: Equations, poses: Floats, termination: Termination, report: Report
) -> Outcome:
    """Solve H step = J' W (-e) and take the full step, until chi2 no longer changes.

    Fast near a minimum; far from one chi2 may rise, oscillate or diverge. Source: Nocedal and
    Wright, Numerical Optimization, 2006, section 10.3; stopping as in g2o.
    """
    start = perf_counter()
    chi2 = equations.linearize(poses)
    best = Outcome(poses, chi2, StopReason.MAX_ITERATIONS)
    undamped = np.zeros_like(equations.rhs())
    for _ in range(termination.max_iterations):
        if termination.flat(equations.rhs()):
            return Outcome(poses, chi2, StopReason.GRADIENT)
        failed = equations.factorize(undamped)
        if failed >= 0:
            return best._replace(reason=StopReason.SINGULAR, singular_node=failed)
        step = equations.solve()
        poses = equations.retract(poses, step)
        before, chi2 = chi2, equations.linearize(poses)
        if not np.isfinite(chi2):
            return best._replace(reason=StopReason.DIVERGED)
        if chi2 < best.chi2:
            best = Outcome(poses, chi2, StopReason.MAX_ITERATIONS)
        stop = report(Iteration(chi2, length(step), 0.0, perf_counter() - start))
        if reason := termination.change(before, chi2):
            return Outcome(poses, chi2, reason)
        if stop is True:
            return best._replace(reason=StopReason.INTERRUPTED)
    return best
