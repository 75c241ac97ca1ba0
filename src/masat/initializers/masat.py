"""Multi-Ancestor Spatial Approximation Tree (MASAT)."""

from __future__ import annotations

from masat import _core
from masat.graph import PoseGraph
from masat.initializers.roots import gauge_poses


def masat(graph: PoseGraph) -> PoseGraph:
    """Place each node, breadth-first, at the average of what its placed neighbors say.

    Positions are averaged as vectors, headings as unit vectors, 3D rotations as unit quaternions of
    like sign; proposals weigh the same, information plays no part. One pass over the edges: linear
    time, whatever the noise. Source: Hars, Multi-Ancestor Spatial Approximation Tree (MASAT), the
    algorithm of its section 3.
    """
    roots, poses, notes = gauge_poses(graph)
    placed = _core.place_by_masat(graph.topology, roots, graph.measurements, poses)
    return graph.with_poses(placed, notes=notes)
