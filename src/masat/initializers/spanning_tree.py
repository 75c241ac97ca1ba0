"""Breadth-first spanning tree."""

from __future__ import annotations

import numpy as np

from masat import _core
from masat.graph import PoseGraph
from masat.initializers.roots import gauge_poses


def spanning_tree(graph: PoseGraph) -> PoseGraph:
    """Place each node along the breadth-first tree: the fewest edges from the root.

    Of several edges between two nodes the first in the list is taken. As g2o's spanning-tree guess.
    """
    roots, poses, notes = gauge_poses(graph)
    placed, _ = _core.place_along_tree(
        graph.topology, roots, np.empty(0, np.bool_), graph.measurements, poses
    )
    return graph.with_poses(placed, notes=notes)
