"""Odometry: dead reckoning along consecutive ids."""

from __future__ import annotations

from masat import _core
from masat.chain import odometry_edges as odometry_edges
from masat.graph import PoseGraph
from masat.initializers.roots import gauge_poses


def odometry(graph: PoseGraph) -> PoseGraph:
    """Chain the measurements between nodes with consecutive ids.

    In a list of ids with gaps, neighbors in the list count as consecutive; of several edges between
    two consecutive nodes the first in the list is taken. Where the chain is broken, its pieces
    are joined by the tree with the fewest other edges, and the notes tell how many.
    """
    roots, poses, notes = gauge_poses(graph)
    chain = odometry_edges(graph)
    placed, used = _core.place_along_tree(graph.topology, roots, chain, graph.measurements, poses)
    bridges = used[~chain[used]]
    if len(bridges):
        first = bridges.min()
        notes.append(
            f"the odometry chain is broken: {len(bridges)} other edges bridge it, such as "
            f"{graph.edges[first, 0]} -> {graph.edges[first, 1]}"
        )
    return graph.with_poses(placed, notes=notes)
