"""Powell's dogleg method."""

from __future__ import annotations

from functools import partial
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
    largest,
    length,
)

_MIN_RADIUS = 1e-14


def dogleg(
    equations: Equations, poses: Floats, termination: Termination, report: Report
) -> Outcome:
    """Take the Gauss-Newton step as far as a trust region allows, bent to the steepest descent.

    One factorization an iteration, however often the region shrinks. Lengths are in the metric of
    the diagonal of H, which needs no scale between meters and radians. Sources: Powell, A new
    algorithm for unconstrained optimization, 1970; Nocedal and Wright, Numerical Optimization,
    2006, algorithm 4.1 and section 4.1.
    """
    start = perf_counter()
    chi2 = equations.linearize(poses)
    radius = np.inf
    for _ in range(termination.max_iterations):
        rhs = equations.rhs()
        if termination.flat(partial(largest, rhs)):
            return Outcome(poses, chi2, StopReason.GRADIENT)
        failed = equations.factorize(np.zeros_like(rhs))
        if failed >= 0:
            return Outcome(poses, chi2, StopReason.SINGULAR, failed)
        scale = np.sqrt(equations.diagonal())
        newton = equations.solve()
        farthest = length(scale * newton)
        fraction, step, bent = 1.0, newton, rhs  # H newton = rhs
        steepest = None
        while True:
            if farthest > radius:
                steepest = steepest or _steepest_descent(equations, rhs, scale)
                cauchy, h_cauchy = steepest
                fraction, bend = _path(scale * newton, scale * cauchy, radius)
                step = fraction * newton + bend * cauchy
                bent = fraction * rhs + bend * h_cauchy
            predicted = float((step * (2 * rhs - bent)).sum())
            moved = equations.retract(poses, step)
            after = equations.chi2(moved)
            if after < chi2:
                break
            if fraction == 1 and (reason := termination.change(chi2, chi2 - predicted)):
                return Outcome(poses, chi2, reason)
            radius = length(scale * step) / 4
            if not radius > _MIN_RADIUS * farthest:
                return Outcome(poses, chi2, StopReason.STALLED)
        gain = (chi2 - after) / predicted
        went = length(scale * step)
        if gain > 0.75:
            radius = max(radius, 3 * went)
        elif gain < 0.25:
            radius = went / 2
        before, poses = chi2, moved
        stop = report(Iteration(after, length(step), 0.0, perf_counter() - start))
        chi2 = equations.linearize(poses)
        # A step that the region cut short does not show convergence.
        if fraction == 1 and (reason := termination.change(before, chi2)):
            return Outcome(poses, chi2, reason)
        if stop is True:
            return Outcome(poses, chi2, StopReason.INTERRUPTED)
    return Outcome(poses, chi2, StopReason.MAX_ITERATIONS)


def _steepest_descent(equations: Equations, rhs: Floats, scale: Floats) -> tuple[Floats, Floats]:
    """Return the best step of steepest descent, and H times it."""
    down = rhs / scale**2
    curved = equations.multiply(down)
    curvature = float((down * curved).sum())
    best = float((rhs * down).sum()) / curvature if curvature > 0 else 0.0
    return best * down, best * curved


def _path(newton: Floats, cauchy: Floats, radius: float) -> tuple[float, float]:
    """Return the fractions of the two steps at the point where the dogleg leaves the region.

    The Gauss-Newton step is too long for the region.
    """
    reach = length(cauchy)
    if reach >= radius:
        return 0.0, radius / reach
    # |cauchy + t (newton - cauchy)| = radius, for t in [0, 1].
    across = newton - cauchy
    a, b = float(np.square(across).sum()), float((cauchy * across).sum())
    c = radius**2 - reach**2
    t = c / (b + np.sqrt(b * b + a * c)) if b > 0 else (np.sqrt(b * b + a * c) - b) / a
    return float(t), float(1 - t)
