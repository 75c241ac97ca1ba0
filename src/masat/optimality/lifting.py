"""Lifting poses to a higher rank and back."""

from __future__ import annotations

from masat.arrays import Floats
from masat.graph import PoseGraph
from masat.optimality.relaxation import Relaxation
from masat.optimizers.translations import solve_translations

# Of the cost: a step in the higher rank that promises less is the last.
_DECREASE = 1e-5


def lift(graph: PoseGraph, *, seed: int = 0) -> Floats:
    """Return poses to optimize from: rounded from a minimum of the chordal cost in a higher rank.

    Where memory does not allow the higher rank (`masat.optimality.relaxation`), the poses of the graph.

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
    top = relaxed.minimize_lifted(x, decrease=_DECREASE, seed=seed)
    poses = relaxed.poses(top.unknowns)
    held = graph.index(graph.gauge)
    poses[held] = graph.poses[held]
    return solve_translations(graph, poses)
