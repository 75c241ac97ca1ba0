"""The equations of a robust cost: iteratively reweighted least squares, under any optimizer."""

from __future__ import annotations

from masat import _core
from masat.arrays import Flags, Floats
from masat.graph import PoseGraph
from masat.optimizers.equations import Equations
from masat.optimizers.losses import RobustCost
from masat.residuals import chi2_per_edge


def robust_equations(graph: PoseGraph, inner: _core.NormalEquations, cost: RobustCost) -> Equations:
    """Return the equations of a robust cost of a graph, in the memory of those of its chi2.

    H is the sum of the weighted J' W J. It lacks the curvature of the losses, which is never
    positive: the model lies above the cost as far as the residuals are linear.
    """
    if isinstance(cost.loss, _core.Loss):
        return _InCore(inner, cost.loss, cost.trusted)
    return _TwoPasses(graph, inner, cost)


class _Reweighted:
    """What does not depend on the loss."""

    def __init__(self, inner: _core.NormalEquations) -> None:
        self._inner = inner
        self.rhs, self.diagonal, self.multiply = inner.rhs, inner.diagonal, inner.multiply
        self.factorize, self.solve, self.retract = inner.factorize, inner.solve, inner.retract


class _InCore(_Reweighted):
    """With a loss of the core, which weighs each edge while it is linearized."""

    def __init__(
        self, inner: _core.NormalEquations, loss: _core.Loss, trusted: Flags | None
    ) -> None:
        super().__init__(inner)
        self._loss, self._trusted = loss, trusted

    def chi2(self, poses: Floats, /) -> float:
        """Return the robust cost."""
        return self._inner.robust_cost(poses, self._loss, self._trusted)

    def linearize(self, poses: Floats, /) -> float:
        """Set the weighted system; return the robust cost."""
        return self._inner.linearize_robust(poses, self._loss, self._trusted)


class _TwoPasses(_Reweighted):
    """With a loss in Python, which needs chi2 of all edges before they are linearized."""

    def __init__(self, graph: PoseGraph, inner: _core.NormalEquations, cost: RobustCost) -> None:
        super().__init__(inner)
        self._graph, self._robust = graph, cost
        self._last: tuple[Floats, float, Floats] | None = None

    def chi2(self, poses: Floats, /) -> float:
        """Return the robust cost."""
        return self._values(poses)[0]

    def linearize(self, poses: Floats, /) -> float:
        """Set the weighted system; return the robust cost."""
        cost, weights = self._values(poses)
        self._inner.linearize(poses, weights)
        return cost

    def _values(self, poses: Floats) -> tuple[float, Floats]:
        # Optimizers linearize where they have asked for the cost: the weights are known there.
        if self._last is None or self._last[0] is not poses:
            rho, weights = self._robust(chi2_per_edge(self._graph, poses))
            self._last = poses, float(rho.sum()), weights
        return self._last[1:]
