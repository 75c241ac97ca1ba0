"""Residuals of the edges, and their parts of chi2, at some poses."""

from __future__ import annotations

from typing import TYPE_CHECKING

from masat import _core
from masat.arrays import Floats
from masat.errors import GraphError

if TYPE_CHECKING:
    from masat.graph import PoseGraph


def residuals(graph: PoseGraph, poses: Floats | None = None) -> Floats:
    """Return the residual e of each edge, the step from its measurement to the poses.

    Parameters
    ----------
    graph : PoseGraph
        The graph.
    poses : ndarray, (n, 3) or (n, 7), optional
        Poses in the order of `graph.ids`. Default: those of the graph.

    Returns
    -------
    ndarray, (m, 3) or (m, 6)
        z^-1 (a^-1 b) as x, y, theta, or as translation and vector part of the quaternion (qw >= 0),
        as in g2o: meters, radians in 2D, the sine of half the angle in 3D.
    """
    return _core.residuals(graph.topology, graph.measurements, _poses(graph, poses))


def chi2_per_edge(graph: PoseGraph, poses: Floats | None = None) -> Floats:
    """Return e' W e of each edge, (m,), without a factor 1/2; parameters as in `residuals`."""
    return _core.chi2_per_edge(
        graph.topology, graph.measurements, graph.information, _poses(graph, poses)
    )


def _poses(graph: PoseGraph, poses: Floats | None) -> Floats:
    chosen = graph.poses if poses is None else poses
    if chosen is None:
        raise GraphError("the graph has no poses: give it some with masat.initialize")
    return chosen
