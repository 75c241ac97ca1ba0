"""The Levenberg-Marquardt method."""

from __future__ import annotations

from time import perf_counter

import numpy as np

from masat.arrays import Floats
from masat.lie import DOF
from masat.optimizers.equations import Equations
from masat.optimizers.termination import (
    Iteration,
    Outcome,
    Report,
    StopReason,
    Termination,
    length,
)

# The softest modes of long chains lie many decades below the diagonal, so that already little
# damping slows them down: the first step is nearly that of Gauss-Newton.
_FIRST_DAMPING = 1e-12
_MIN_DAMPING = 1e-15
_MAX_DAMPING = 1e12
_LINEAR = 1e-6
_MIN_SCALE = 1e-12


def levenberg_marquardt(
    equations: Equations, poses: Floats, termination: Termination, report: Report
) -> Outcome:
    """Solve (H + damping D) step = J' W (-e), with as much damping as chi2 needs to fall.

    D is the diagonal of H at the rotations. Translations enter the residual linearly once the
    rotations are known: they need no damping, which would only slow them down.
    Sources: Marquardt, An algorithm for least-squares estimation of nonlinear parameters, 1963;
    damping after Nielsen, Damping parameter in Marquardt's method, 1999.
    """
    start = perf_counter()
    chi2 = equations.linearize(poses)
    damping, growth = _FIRST_DAMPING, 2.0
    failed = -1
    for _ in range(termination.max_iterations):
        rhs = equations.rhs()
        if termination.flat(rhs):
            return Outcome(poses, chi2, StopReason.GRADIENT)
        scale = _scale(equations.diagonal(), poses)
        undisturbed = True
        while True:
            failed = equations.factorize(damping * scale)
            if failed < 0:
                step = equations.solve()
                predicted = float((step * (rhs + damping * scale * step)).sum())
                moved = equations.retract(poses, step)
                after = equations.chi2(moved)
                if after < chi2:
                    break
                # At the bottom only rounding is left to gain.
                if undisturbed and (reason := termination.change(chi2, chi2 - predicted)):
                    return Outcome(poses, chi2, reason)
            undisturbed = False
            damping *= growth
            growth *= 2
            if damping > _MAX_DAMPING:
                if failed >= 0:
                    return Outcome(poses, chi2, StopReason.SINGULAR, failed)
                return Outcome(poses, chi2, StopReason.STALLED)
        gain = (chi2 - after) / predicted
        before, poses = chi2, moved
        stop = report(Iteration(after, length(step), damping, perf_counter() - start))
        chi2 = equations.linearize(poses)
        # A step that damping made short does not show convergence.
        if undisturbed and (reason := termination.change(before, chi2)):
            return Outcome(poses, chi2, reason)
        if stop is True:
            return Outcome(poses, chi2, StopReason.INTERRUPTED)
        damping = max(damping * max(0.1, 1 - (2 * gain - 1) ** 3), _MIN_DAMPING)
        growth = 2.0
    return Outcome(poses, chi2, StopReason.MAX_ITERATIONS)


def _scale(diagonal: Floats, poses: Floats) -> Floats:
    """Return D; a little of the translations' part lets heavy damping repair a singular system."""
    dimension = 2 if poses.shape[1] == 3 else 3
    scale = diagonal.reshape(-1, DOF[dimension]).copy()
    scale[:, :dimension] *= _LINEAR
    floored: Floats = np.maximum(scale, _MIN_SCALE * scale.max())
    return floored.ravel()
