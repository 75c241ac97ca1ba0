"""The poses that came with the graph."""

from __future__ import annotations

from masat.errors import InitializationError
from masat.graph import PoseGraph


def given(graph: PoseGraph) -> PoseGraph:
    """Keep the graph's own poses."""
    if graph.poses is None:
        raise InitializationError(
            "the graph has no poses of its own to start from: choose another initial guess"
        )
    return graph
