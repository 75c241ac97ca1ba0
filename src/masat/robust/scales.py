"""How far the measurements of a map check each other, and what scale their information has."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from masat import _core
from masat.arrays import Flags, Floats
from masat.graph import PoseGraph
from masat.quantiles import FAR_GATE
from masat.redundancy import whitened

# Redundancy that a group of edges needs for a scale, in edges.
_MIN_REDUNDANCY = 10.0
_MAX_TRIMS = 5


class Scales(NamedTuple):
    """Factors by which covariances exceed what the information says; 1 if it is right.

    Attributes
    ----------
    trusted : float or None
        That of the trusted edges, as a rule odometry; None if too few others check them.
    closures : float or None
        That of the loop closures.
    """

    trusted: float | None
    closures: float | None


@dataclass(frozen=True, eq=False)
class Redundancy:
    """What the other edges of a map say of each edge.

    Attributes
    ----------
    chi2 : ndarray, (m,)
        chi2 of each edge.
    redundancy_numbers : ndarray, (m,)
        The part of it that the others check, from 0, for an edge that alone joins two parts, to the
        degrees of freedom: the expected chi2 if all information is right.
    left_out : ndarray, (m,)
        Squared Mahalanobis distance of the measurement from what the others predict.
    dof : int
        Degrees of freedom of an edge.
    """

    chi2: Floats
    redundancy_numbers: Floats
    left_out: Floats
    dof: int

    def scale(self, which: Flags) -> float | None:
        """Return the factor by which the covariances of some edges exceed their information.

        Edges far beyond it do not count. Without enough redundancy it is None. Source: Foerstner,
        Ein Verfahren zur Schaetzung von Varianz- und Kovarianzkomponenten, 1979.
        """
        used, scale, dof = which.copy(), 1.0, self.dof
        for _ in range(_MAX_TRIMS):
            redundant = float(self.redundancy_numbers[used].sum())
            if redundant < _MIN_REDUNDANCY * dof:
                return None
            scale = float(self.chi2[used].sum()) / redundant
            outlying = used & (self.left_out > FAR_GATE[dof] * scale)
            if not outlying.any():
                break
            used &= ~outlying
        return scale if scale > 0 else None

    def scales(self, trusted: Flags) -> Scales:
        """Return the scales of the trusted edges and of the others."""
        return Scales(self.scale(trusted), self.scale(~trusted))


def redundancy(graph: PoseGraph, equations: _core.NormalEquations | None = None) -> Redundancy:
    """Return what the other edges of a map say of each edge.

    With the residual e of an edge at the minimum, the covariance R of its measurement and that of
    the map along it S, the measurement is e' (R - S)^-1 e from what the others predict: Baarda, A
    testing procedure for use in geodetic networks, 1968.

    Parameters
    ----------
    graph : PoseGraph
        A graph at its minimum.
    equations : NormalEquations, optional
        Those of the graph, to be used again.
    """
    compared = whitened(graph, equations)
    chi2 = np.square(compared.residuals).sum(axis=1)
    numbers = np.einsum("kii->k", compared.left).clip(0, graph.dof)
    left_out = compared.distances()
    return Redundancy(chi2, numbers, np.maximum(left_out, chi2), graph.dof)
