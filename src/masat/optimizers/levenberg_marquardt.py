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

# Pose graphs are long chains: their softest modes lie many decades below the diagonal, so already a
# small damping of it slows them down. The first step is Gauss-Newton's in all but name.
_FIRST_DAMPING = 1e-12
_LEAST_DAMPING = 1e-15
_MOST_DAMPING = 1e12
_LINEAR = 1e-6
_LEAST_SCALE = 1e-12


def levenberg_marquardt(
    equations: Equations, poses: Floats, termination: Termination, report: Report
) -> Outcome:
    """Solve (H + damping D) step = J' W (-e), with as much damping as chi2 needs to fall.

    D is the diagonal of H at the rotations. Translations enter the error linearly once the
    rotations are known: they need no damping, and with it would follow the rotations but slowly.
    Sources: Marquardt, An algorithm for least-squares estimation of nonlinear parameters, 1963;
    damping after Nielsen, Damping parameter in Marquardt's method, 1999.
    """
    start = perf_counter()
    chi2 = equations.linearize(poses)
    damping, growth = _FIRST_DAMPING, 2.0
    broken = -1
    for _ in range(termination.max_iterations):
        rhs = equations.rhs()
        if termination.flat(rhs):
            return Outcome(poses, chi2, StopReason.GRADIENT)
        scale = _scale(equations.diagonal(), poses)
        undisturbed = True
        while True:
            broken = equations.factorize(damping * scale)
            if broken < 0:
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
            if damping > _MOST_DAMPING:
                if broken >= 0:
                    return Outcome(poses, chi2, StopReason.SINGULAR, broken)
                return Outcome(poses, chi2, StopReason.STALLED)
        gain = (chi2 - after) / predicted
        before, poses = chi2, moved
        stop = report(Iteration(after, length(step), damping, perf_counter() - start))
        chi2 = equations.linearize(poses)
        # Heavy damping makes short steps anywhere: they prove nothing.
        if undisturbed and (reason := termination.change(before, chi2)):
            return Outcome(poses, chi2, reason)
        if stop is True:
            return Outcome(poses, chi2, StopReason.INTERRUPTED)
        damping = max(damping * max(0.1, 1 - (2 * gain - 1) ** 3), _LEAST_DAMPING)
        growth = 2.0
    return Outcome(poses, chi2, StopReason.MAX_ITERATIONS)


def _scale(diagonal: Floats, poses: Floats) -> Floats:
    """Return D; a trace of the translations' part lets heavy damping mend a singular system."""
    dimension = 2 if poses.shape[1] == 3 else 3
    scale = diagonal.reshape(-1, DOF[dimension]).copy()
    scale[:, :dimension] *= _LINEAR
    floored: Floats = np.maximum(scale, _LEAST_SCALE * scale.max())
    return floored.ravel()
