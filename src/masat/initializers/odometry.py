"""Odometry: dead reckoning along consecutive ids."""

from __future__ import annotations

import numpy as np

from masat import _core
from masat.graph import PoseGraph
from masat.initializers.roots import roots_of


def odometry(graph: PoseGraph, root: int | None = None) -> PoseGraph:
    """Chain the measurements between nodes with consecutive ids.

    In a list of ids with gaps, neighbors in the list count as consecutive. Where the chain is
    broken, its pieces are joined by the tree with the fewest other edges, and the notes tell how
    many.
    """
    roots, poses, notes = roots_of(graph, root)
    pairs = graph.edge_indices
    consecutive = np.abs(pairs[:, 0] - pairs[:, 1]) == 1
    placed, used = _core.place_along_tree(
        graph.topology, roots, consecutive, graph.measurements, poses
    )
    bridges = used[~consecutive[used]]
    if len(bridges):
        first = bridges.min()
        notes.append(
            f"the odometry chain is broken: {len(bridges)} other edges bridge it, such as "
            f"{graph.edges[first, 0]} -> {graph.edges[first, 1]}"
        )
    return graph.with_poses(placed, notes=notes)
