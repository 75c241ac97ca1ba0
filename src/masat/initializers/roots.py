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
    notes = []
    count = int(graph.components.max()) + 1
    if count > 1:
        shown = ", ".join(str(a) for a in gauge[:5]) + (", ..." if len(gauge) > 5 else "")
        notes.append(
            f"the graph has {count} components, each placed in a frame of its own, from the roots "
            f"{shown}: nothing measures how they lie to each other"
        )
    return graph.index(gauge).astype(np.int32), poses, notes
