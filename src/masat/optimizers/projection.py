"""Equations whose poses always have the best translations for their rotations."""

from __future__ import annotations

from masat.arrays import Floats
from masat.errors import InitializationError
from masat.optimizers.equations import Equations
from masat.optimizers.translations import BestTranslations


class ProjectedEquations:
    """Normal equations after whose steps the translations are solved for anew.

    chi2 is quadratic in the translations, so that a step can be judged by its rotations alone. Far
    from a minimum, where large parts of a map still have to rotate and their positions move along
    arcs, that takes a fraction of the steps. Sources: Golub and Pereyra, The differentiation of
    pseudo-inverses and nonlinear least squares problems whose variables separate, 1973; for SLAM,
    Khosoussi, Huang, Dissanayake, Exploiting the separable structure of SLAM, RSS 2015. The step
    itself is that of all poses.

    Parameters
    ----------
    inner : Equations
        Those of the chi2 of a graph.
    translations : BestTranslations
        Those of the same graph.
    """

    def __init__(self, inner: Equations, translations: BestTranslations) -> None:
        self._inner, self._translations = inner, translations
        self.chi2, self.linearize = inner.chi2, inner.linearize
        self.rhs, self.diagonal, self.multiply = inner.rhs, inner.diagonal, inner.multiply
        self.factorize, self.solve = inner.factorize, inner.solve

    def retract(self, poses: Floats, step: Floats, /) -> Floats:
        """Return the poses after a step, with the best translations where these are determined."""
        moved = self._inner.retract(poses, step)
        try:
            return self._translations(moved)
        except InitializationError:
            return moved
