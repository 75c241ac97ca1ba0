"""Lifting poses to a higher rank and back: all of them, or those that leave doubt."""

from __future__ import annotations

import numpy as np

from masat import quadratic
from masat.arrays import Floats, Indices
from masat.graph import PoseGraph
from masat.optimizers import optimize
from masat.optimizers.equations import edge_chi2
from masat.regions import Region, Surroundings
from masat.relaxation import Relaxation
from masat.windings import nodes_of_weak_loops

# Edges from a place where the certificate fails: what lies no farther is lifted.
_REACH = 6
# Of the cost: a step in the higher rank that promises less is the last.
_DECREASE = 1e-5


def lift(graph: PoseGraph, *, seed: int = 0) -> Floats:
    """Return the poses of a minimum of chi2 that is reached by way of a higher rank.

    Of the chordal cost (`masat.relaxation`), whose minimum there is rounded and optimised. Where
    memory does not allow the higher rank, the poses of the graph are optimised as they are.

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
    rounded = graph.poses
    if relaxed.can_lift():
        x = relaxed.unknowns(graph.poses, graph.dimension)
        top = relaxed.minimise_lifted(x, decrease=_DECREASE, seed=seed)
        rounded = quadratic.settle(graph, relaxed.poses(top.unknowns))
    result = optimize(graph.with_poses(rounded), relative_tolerance=1e-8, max_iterations=50)
    assert result.graph.poses is not None
    return result.graph.poses


def lift_weak_places(graph: PoseGraph, *, seed: int = 0) -> Floats:
    """Go from a minimum of chi2 to a lower one, in a higher rank where the certificate fails.

    The matrix of the certificate (`masat.relaxation`) has few negative eigenvalues at a good
    minimum, and each belongs to few nodes. These, what lies around them, and the weak loops
    (`masat.windings`) are lifted, the rest held still. Of each connected part the poses of the
    lower chi2 stand. Source: as of `masat.relaxation.Relaxation`, applied to parts of a graph.

    Parameters
    ----------
    graph : PoseGraph
        A graph with poses near a minimum.
    seed : int
        Of the noise that opens the higher rank.

    Returns
    -------
    ndarray, (n, 3) or (n, 7)
    """
    assert graph.poses is not None
    surroundings = Surroundings(graph)
    inside = np.zeros(len(graph.ids), np.bool_)
    inside[Relaxation(graph).weak_places(graph.poses)] = True
    inside = surroundings.around(inside, _REACH)
    inside |= surroundings.around(nodes_of_weak_loops(graph))
    inside[graph.index(graph.anchors)] = False
    if not inside.any():
        return graph.poses
    region = surroundings.region(graph.poses, inside)
    lifted = lift(region.graph, seed=seed)
    lower = _where_lower(region, lifted)
    poses = graph.poses.copy()
    poses[region.graph.ids[lower]] = lifted[lower]
    return poses


def _where_lower(region: Region, poses: Floats) -> Indices:
    """Return the free nodes of the connected parts in which poses have a lower chi2."""
    graph, inside = region
    i, j = graph.edge_indices.T
    both = inside[i] & inside[j]
    free = PoseGraph(
        ids=graph.ids,
        poses=None,
        edges=graph.edges[both],
        measurements=graph.measurements[both],
        information=graph.information[both],
        fixed=graph.ids[:0],
    )
    part = free.components
    rise = edge_chi2(graph.with_poses(poses)) - edge_chi2(graph)
    of_part = np.bincount(part[np.where(inside[i], i, j)], rise, len(graph.ids))
    lower: Indices = np.flatnonzero(inside & (of_part[part] < 0)).astype(np.int32)
    return lower
