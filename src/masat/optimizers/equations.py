"""A graph's normal equations, and what can be said of them beforehand and when they break."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from masat import _core
from masat.arrays import Floats
from masat.graph import PoseGraph

_EPSILON = float(np.finfo(np.float64).eps)


class Equations(Protocol):
    """What an optimizer sees of a cost: its value, and a quadratic model of it.

    That of `_core.NormalEquations` is chi2.
    """

    def chi2(self, poses: Floats, /) -> float:
        """Return the cost."""

    def linearize(self, poses: Floats, /) -> float:
        """Set H and `rhs`, the gradient's negative half; return the cost."""

    def rhs(self) -> Floats:
        """Return the gradient's negative half."""

    def diagonal(self) -> Floats:
        """Return the diagonal of H."""

    def multiply(self, v: Floats, /) -> Floats:
        """Return H v."""

    def factorize(self, damping: Floats, /) -> int:
        """Factorize H plus a diagonal; return -1, or the node where it is not definite."""

    def solve(self) -> Floats:
        """Return the step: what was factorized times it is `rhs`."""

    def retract(self, poses: Floats, step: Floats, /) -> Floats:
        """Return the poses after a step."""


def normal_equations(graph: PoseGraph, threads: int = 1) -> _core.NormalEquations:
    """Lay out the system of a graph in which the anchors hold still."""
    return _core.NormalEquations(
        graph.topology, graph.elimination, graph.measurements, graph.information, threads
    )


def rounding_level(graph: PoseGraph) -> float:
    """Return the chi2 that the rounding of coordinates alone makes.

    A coordinate is known to half a unit in the last place of the largest one; an angle to that
    of 1.
    """
    if graph.poses is None or len(graph.edges) == 0:
        return 0.0
    d = graph.dimension
    reach = max(1.0, float(np.abs(graph.poses[:, :d]).max()))
    diagonal = np.einsum("kii->i", graph.information)
    return float(_EPSILON**2 * (np.square(reach) * diagonal[:d].sum() + diagonal[d:].sum()))


def why_singular(graph: PoseGraph, node: int) -> str:
    """Say which node a singular system leaves open, and what its edges hold."""
    touching = (graph.edge_indices == node).any(axis=1)
    spectrum = np.linalg.eigvalsh(graph.information[touching])
    component = int(np.count_nonzero(graph.components == graph.components[node]))
    return (
        f"the edges around node {graph.ids[node]} (component of {component} nodes) do not "
        f"determine its pose: information from {spectrum.min():.3g} to {spectrum.max():.3g} on "
        f"its {np.count_nonzero(touching)} edges; if a rotation error is half a turn, start "
        "elsewhere; else use Levenberg-Marquardt"
    )
