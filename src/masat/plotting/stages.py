"""The stages of a solve, as graphs to draw side by side."""

from __future__ import annotations

import numpy as np

from masat.graph import PoseGraph
from masat.initializers.odometry import odometry
from masat.initializers.spanning_tree import spanning_tree
from masat.issues import has_placeholder_poses
from masat.optimizers import Result


def before_and_after(graph: PoseGraph, result: PoseGraph | Result) -> dict[str, PoseGraph | Result]:
    """Return what to draw of a solve: the map without optimization, and the optimized map.

    "Before" are the poses of `graph`, unless they are missing or placeholders; then it is odometry,
    and the breadth-first spanning tree if no edge joins nodes with consecutive ids. The initial
    guess of the solve is of no use here: that of `auto` is optimized already. Both maps keep their
    own frames.

    Parameters
    ----------
    graph : PoseGraph
        The graph as it was read.
    result : PoseGraph or Result
        The optimized graph, or the result of the solve.

    Returns
    -------
    dict of str to PoseGraph or Result
        Two titles and what to draw there, for `masat.plot`.
    """
    ends = graph.edge_indices
    if graph.poses is not None and not has_placeholder_poses(graph):
        name, before = "poses of the input", graph
    elif (np.abs(ends[:, 0] - ends[:, 1]) == 1).any():
        name, before = "odometry", odometry(graph)
    else:
        name, before = "spanning tree", spanning_tree(graph)
    return {f"before: {name}": before, "after: optimized": result}
