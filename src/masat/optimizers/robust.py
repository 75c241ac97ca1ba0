"""Robust costs, for edges that may be wrong."""

from __future__ import annotations

import numpy as np

from masat._core import NormalEquations
from masat.arrays import Floats
from masat.graph import PoseGraph
from masat.residuals import chi2_per_edge


class Cauchy:
    """The equations of the sum of c^2 log(1 + chi2 / c^2) over the edges, c being the scale.

    An edge weighs 1 / (1 + chi2 / c^2): iteratively reweighted least squares, under any optimizer.
    H lacks the curvature of the logarithm, which is negative: the model lies above the cost as far
    as the errors are linear. Source: Holland and Welsch, Robust regression using iteratively
    reweighted least-squares, 1977.
    """

    def __init__(self, graph: PoseGraph, inner: NormalEquations, scale: float) -> None:
        self._graph = graph
        self._inner = inner
        self._squared = scale**2
        self.rhs, self.diagonal, self.multiply = inner.rhs, inner.diagonal, inner.multiply
        self.factorize, self.solve, self.retract = inner.factorize, inner.solve, inner.retract

    def chi2(self, poses: Floats) -> float:
        """Return the robust cost."""
        return self._cost(chi2_per_edge(self._graph, poses))

    def linearize(self, poses: Floats) -> float:
        """Set the weighted system; return the robust cost."""
        chi2 = chi2_per_edge(self._graph, poses)
        self._inner.linearize(poses, 1 / (1 + chi2 / self._squared))
        return self._cost(chi2)

    def _cost(self, chi2: Floats) -> float:
        return float(self._squared * np.log1p(chi2 / self._squared).sum())
