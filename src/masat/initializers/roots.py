"""Where a walk over the graph begins: at the gauge nodes, one or more in each component."""

from __future__ import annotations

import numpy as np

from masat import lie
from masat.arrays import Floats, Indices
from masat.graph import PoseGraph


def gauge_poses(graph: PoseGraph) -> tuple[Indices, Floats, list[str]]:
    """Return the indices of the gauge nodes, poses with these nodes placed, and notes.

    Fixed nodes have their own poses, a gauge-fixed node lies at the identity.
    """
    gauge = graph.gauge
    poses = np.tile(lie.identity(graph.dimension), (len(graph.ids), 1))
    if graph.poses is not None:
        fixed = graph.index(graph.fixed)
        poses[fixed] = graph.poses[fixed]
    return graph.index(gauge).astype(np.int32), poses, notes_of_components(graph)


def notes_of_components(graph: PoseGraph) -> list[str]:
    """Return a note if there are several components.

    Fixed nodes and priors place their components in the world, if these are in one frame. Each
    other component has a frame of its own, that of its gauge-fixed node.
    """
    count = int(graph.components.max()) + 1
    if count == 1:
        return []
    roots = np.setdiff1d(graph.gauge, graph.fixed)
    shown = ", ".join(map(str, roots[:5])) + (", ..." if len(roots) > 5 else "")
    own = f"placed in a frame of its own, from the roots {shown}"
    if len(roots) == 0:
        how = "each placed by its fixed nodes or priors"
    elif len(roots) == count:
        how = f"each {own}"
    else:
        how = f"{count - len(roots)} placed by fixed nodes or priors, each other one {own}"
    return [
        f"the graph has {count} components, {how}: nothing else measures how they lie to each other"
    ]
