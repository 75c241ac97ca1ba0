"""The Levenberg-Marquardt method."""

from __future__ import annotations

from time import perf_counter
from typing import Any

from masat.optimizers.damped import DampedSystem, damped
from masat.optimizers.equations import Equations
from masat.optimizers.termination import (
    Iteration,
    Outcome,
    Report,
    StopReason,
    Termination,
)

# The softest modes of long chains lie many decades below the diagonal, so that already little
# damping slows them down: the first step is nearly that of Gauss-Newton.
_FIRST_DAMPING = 1e-12
_MIN_DAMPING = 1e-15
_MAX_DAMPING = 1e12


def levenberg_marquardt(
    equations: Equations | DampedSystem[Any],
    poses: Any,
    termination: Termination,
    report: Report,
) -> Outcome:
    """Solve (H + damping D) step = J' W (-e), with as much damping as chi2 needs to fall.

    D is the diagonal of H at the rotations. Translations enter the residual linearly once the
    rotations are known: they need no damping, which would only slow them down.
    Sources: Marquardt, An algorithm for least-squares estimation of nonlinear parameters, 1963;
    damping after Nielsen, Damping parameter in Marquardt's method, 1999.
    """
    start = perf_counter()
    system = damped(equations, poses)
    chi2 = system.linearize(poses)
    damping, growth = _FIRST_DAMPING, 2.0
    for _ in range(termination.max_iterations):
        if termination.flat(system.steepest):
            return Outcome(poses, chi2, StopReason.GRADIENT)
        undisturbed = True
        while True:
            solved = system.damped_step(damping)
            if not isinstance(solved, int):
                moved = system.retract(poses, solved.step)
                after = system.chi2(moved)
                if after < chi2:
                    break
                # At the bottom only rounding is left to gain.
                if undisturbed and (reason := termination.change(chi2, chi2 - solved.predicted())):
                    return Outcome(poses, chi2, reason)
            undisturbed = False
            damping *= growth
            growth *= 2
            if damping > _MAX_DAMPING:
                if isinstance(solved, int):
                    return Outcome(poses, chi2, StopReason.SINGULAR, solved)
                return Outcome(poses, chi2, StopReason.STALLED)
        gain = (chi2 - after) / solved.predicted()
        before, poses = chi2, moved
        stop = report(Iteration(after, solved.length(), damping, perf_counter() - start))
        chi2 = system.linearize(poses)
        # A step that damping made short does not show convergence.
        if undisturbed and (reason := termination.change(before, chi2)):
            return Outcome(poses, chi2, reason)
        if stop is True:
            return Outcome(poses, chi2, StopReason.INTERRUPTED)
        damping = max(damping * max(0.1, 1 - (2 * gain - 1) ** 3), _MIN_DAMPING)
        growth = 2.0
    return Outcome(poses, chi2, StopReason.MAX_ITERATIONS)
