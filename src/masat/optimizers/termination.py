"""When an optimizer stops, and what it reports."""

from __future__ import annotations

import enum
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from masat.arrays import Floats


class StopReason(enum.Enum):
    """Why an optimization stopped."""

    RELATIVE_CHANGE = "relative change of chi2 below the tolerance"
    ABSOLUTE_CHANGE = "change of chi2 below the absolute tolerance"
    ROUNDING = "change of chi2 below the rounding of the coordinates"
    GRADIENT = "gradient below the tolerance"
    NOTHING_TO_DO = "no node is free to move"
    MAX_ITERATIONS = "iteration limit reached"
    DIVERGED = "chi2 grew beyond its initial value or became infinite"
    SINGULAR = "the system is singular"
    STALLED = "no damping gives a step downhill"
    INTERRUPTED = "stopped by the caller, by Ctrl-C or at the end of the time budget"

    @property
    def converged(self) -> bool:
        """Whether the poses are a (local) minimum."""
        return self in _CONVERGED

    def said(self, iterations: int, advice: str | None = None) -> str:
        """Return the reason in a sentence, with what to do about it.

        Parameters
        ----------
        iterations : int
            After how many iterations.
        advice : str, optional
            What to do. Default: what helps whatever the graph is.
        """
        said = f"{self.value} after {iterations} iteration{'' if iterations == 1 else 's'}"
        advice = _ADVICE.get(self) if advice is None else advice
        return said if advice is None else f"{said}: {advice}"


_CONVERGED = {
    StopReason.RELATIVE_CHANGE,
    StopReason.ABSOLUTE_CHANGE,
    StopReason.ROUNDING,
    StopReason.GRADIENT,
    StopReason.NOTHING_TO_DO,
}

_ADVICE = {
    StopReason.DIVERGED: "try Levenberg-Marquardt or another initial guess",
    StopReason.MAX_ITERATIONS: "raise the limit, or try another initial guess",
    StopReason.STALLED: "the poses are as good as rounding allows, or far from any minimum",
}


class Iteration(NamedTuple):
    """One iteration of an optimizer.

    Attributes
    ----------
    chi2 : float
        chi2 after the iteration.
    step : float
        Euclidean length of the step, all nodes together (meters and radians mixed).
    damping : float
        Damping relative to the diagonal of H; 0 in Gauss-Newton.
    seconds : float
        Wall time since the optimizer began.
    """

    chi2: float
    step: float
    damping: float
    seconds: float


Report: TypeAlias = Callable[[Iteration], object]
"""Called after each iteration; returning True stops the optimizer."""

ReportPoses: TypeAlias = Callable[[Floats], object]
"""Called with the poses after each iteration."""


@dataclass(frozen=True)
class Termination:
    """The limits and tolerances of `masat.optimize`."""

    max_iterations: int
    relative: float
    absolute: float
    gradient: float
    rounding: float

    def change(self, before: float, after: float) -> StopReason | None:
        """Return why to stop after an accepted step, if there is a reason.

        The relative test is g2o's, 0 <= (before - after) / after < relative.
        """
        if abs(before - after) <= self.absolute:
            return StopReason.ABSOLUTE_CHANGE
        if abs(before - after) <= blur(after, self.rounding):
            return StopReason.ROUNDING
        if 0 <= before - after < self.relative * after:
            return StopReason.RELATIVE_CHANGE
        return None

    def with_iterations(self, limit: int) -> Termination:
        """Return the same with another limit of the iterations."""
        return replace(self, max_iterations=max(limit, 0))

    def flat(self, steepest: Callable[[], float]) -> bool:
        """Tell whether the gradient of chi2, -2 rhs, is below the tolerance (maximum norm).

        `steepest` returns the largest absolute value of rhs.
        """
        return self.gradient > 0 and 2 * steepest() <= self.gradient


def blur(chi2: float, rounding: float) -> float:
    """Return the changes of chi2 that rounding may make: smaller ones mean nothing.

    Residuals e known to de, with de' W de = rounding, blur chi2 by 2 e' W de + de' W de at most,
    which the Cauchy-Schwarz inequality bounds.
    """
    return float(2 * (max(chi2, 0.0) * rounding) ** 0.5 + rounding)


class Outcome(NamedTuple):
    """What an optimizer returns: the poses of the lowest chi2, and why it stopped.

    The poses are an array unless the equations keep them elsewhere.
    """

    poses: Any
    chi2: float
    reason: StopReason
    singular_node: int | None = None


def largest(rhs: Floats) -> float:
    """Return the largest absolute value."""
    return float(np.abs(rhs).max())


def length(step: Floats) -> float:
    """Return the Euclidean norm; without BLAS, which wakes threads for so little."""
    return float(np.sqrt(np.square(step).sum()))
