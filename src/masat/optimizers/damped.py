"""What Gauss-Newton and Levenberg-Marquardt see of a system: poses, damped steps and a few numbers.

Poses and steps are handed on, never looked into: they may be arrays, or live elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Generic, NamedTuple, Protocol, TypeVar, runtime_checkable

import numpy as np

from masat.arrays import Floats
from masat.lie import DOF
from masat.optimizers.equations import Equations
from masat.optimizers.termination import largest, length

# Translations are damped by this fraction of their diagonal: only as much as lets heavy damping
# repair a singular system.
LINEAR = 1e-6
# Floor of the diagonal by which steps are damped, relative to its largest entry.
MIN_SCALE = 1e-12

Poses = TypeVar("Poses")


class DampedStep(NamedTuple):
    """A solution of (H + damping D) step = rhs.

    Attributes
    ----------
    step : object
        The step, for `DampedSystem.retract`.
    length : callable
        Returns its Euclidean length.
    predicted : callable
        Returns by how much chi2 falls after it, by the quadratic model of chi2.
    """

    step: Any
    length: Callable[[], float]
    predicted: Callable[[], float]


@runtime_checkable
class DampedSystem(Protocol[Poses]):
    """The equations of a cost, whose steps are damped in proportion to the diagonal of H."""

    def chi2(self, poses: Poses, /) -> float:
        """Return the cost."""

    def linearize(self, poses: Poses, /) -> float:
        """Set the system at poses; return the cost."""

    def steepest(self) -> float:
        """Return the largest absolute value of the gradient's negative half."""

    def damped_step(self, damping: float, /) -> DampedStep | int:
        """Return the step, or the node at which the damped system is not positive definite."""

    def retract(self, poses: Poses, step: Any, /) -> Poses:
        """Return the poses after a step."""


class LocalSystem(Generic[Poses]):
    """Equations whose poses and steps are arrays, (n, 3) or (n, 7) and flat."""

    def __init__(self, equations: Equations, poses: Floats) -> None:
        self._equations = equations
        self._dimension = 2 if poses.shape[1] == 3 else 3
        self._rhs: Floats | None = None
        self._scale: Floats | None = None
        self.chi2, self.retract = equations.chi2, equations.retract

    def linearize(self, poses: Floats, /) -> float:
        """Set the system at poses; return the cost."""
        self._rhs = self._scale = None
        return self._equations.linearize(poses)

    def steepest(self) -> float:
        """Return the largest absolute value of the gradient's negative half."""
        return largest(self._known_rhs())

    def damped_step(self, damping: float, /) -> DampedStep | int:
        """Return the step, or the node at which the damped system is not positive definite."""
        rhs = self._known_rhs()
        if damping == 0:
            added = np.zeros_like(rhs)
        else:
            if self._scale is None:
                self._scale = damping_scale(self._equations.diagonal(), self._dimension)
            added = damping * self._scale
        failed = self._equations.factorize(added)
        if failed >= 0:
            return failed
        step = self._equations.solve()
        return DampedStep(
            step, lambda: length(step), lambda: float((step * (rhs + added * step)).sum())
        )

    def _known_rhs(self) -> Floats:
        if self._rhs is None:
            self._rhs = self._equations.rhs()
        return self._rhs


def damped(equations: Equations | DampedSystem[Any], poses: Any) -> DampedSystem[Any]:
    """Return equations as a damped system, which they may be already."""
    if isinstance(equations, DampedSystem):
        return equations
    return LocalSystem(equations, poses)


def damping_scale(diagonal: Floats, dimension: int, floor: float | None = None) -> Floats:
    """Return D, the diagonal of H at the rotations, and a little of it at the translations.

    Parameters
    ----------
    diagonal : ndarray, (3 n,) or (6 n,)
        The diagonal of H.
    dimension : int
        2 or 3.
    floor : float, optional
        Smallest entry. Default: in proportion to the largest one.
    """
    scale = diagonal.reshape(-1, DOF[dimension]).copy()
    scale[:, :dimension] *= LINEAR
    floored: Floats = np.maximum(scale, MIN_SCALE * scale.max() if floor is None else floor)
    return floored.ravel()
