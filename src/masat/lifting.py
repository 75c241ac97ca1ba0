"""Lifting poses to a higher rank and back."""

from __future__ import annotations

from masat import quadratic
from masat.arrays import Floats
from masat.graph import PoseGraph
from masat.relaxation import Relaxation

# Of the cost: a step in the higher rank that promises less is the last.
_DECREASE = 1e-5


def lift(graph: PoseGraph, *, seed: int = 0) -> Floats:
    """Return poses to optimise from: rounded from a minimum of the chordal cost in a higher rank.

    Where memory does not allow the higher rank (`masat.relaxation`), the poses of the graph.

    Parameters
    ----------
    graph : PoseGraph
        A graph with poses.
    seed : int
        Of the noise that opens the higher rank.

    Returns
    -------
    ndarray, (n, 3) or (n, 7)
    """
    assert graph.poses is not None
    relaxed = Relaxation(graph)
    if not relaxed.can_lift():
        return graph.poses
    x = relaxed.unknowns(graph.poses, graph.dimension)
    top = relaxed.minimise_lifted(x, decrease=_DECREASE, seed=seed)
    poses = relaxed.poses(top.unknowns)
    held = graph.index(graph.anchors)
    poses[held] = graph.poses[held]
    return quadratic.settle(graph, poses)
