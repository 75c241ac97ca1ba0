"""Edges that contradict the rest of a map."""

from __future__ import annotations

import numpy as np

from masat.arrays import Ids
from masat.graph import PoseGraph

# chi2 of a single edge with 3 or 6 degrees of freedom: its median, and what one in 100,000 exceeds.
_MEDIAN = {3: 2.366, 6: 5.348}
_GATE = {3: 25.9, 6: 33.1}
# Beyond the gate by this factor, an edge is more than an unlucky measurement.
_FAR = 4.0


def outlying_edges(graph: PoseGraph) -> Ids:
    """Return the indices of edges whose chi2 is far beyond their gate, the worst first.

    The gate of an edge is the chi2 that one honest measurement in 100,000 exceeds. Where the
    typical edge has a chi2 above what its information promises, the gate is raised as much.

    Parameters
    ----------
    graph : PoseGraph
        A graph with poses at a minimum.

    Returns
    -------
    ndarray of int64
    """
    chi2 = graph.chi2_per_edge
    if len(chi2) == 0:
        return np.empty(0, np.int64)
    scale = max(1.0, float(np.median(chi2)) / _MEDIAN[graph.dof])
    far = np.flatnonzero(chi2 > _FAR * scale * _GATE[graph.dof])
    return far[np.argsort(-chi2[far], kind="stable")]


def describe_outliers(graph: PoseGraph) -> tuple[str, ...]:
    """Return a sentence that names the worst outlying edges, or nothing if there are none."""
    far = outlying_edges(graph)
    if len(far) == 0:
        return ()
    worst = ", ".join(
        f"{a} -> {b} ({chi2:.3g})"
        for (a, b), chi2 in zip(graph.edges[far[:3]], graph.chi2_per_edge[far[:3]], strict=True)
    )
    return (
        f"{len(far)} of {len(graph.edges)} edges contradict the map far beyond their information "
        f"(chi2 of the worst: {worst}): look for wrong loop closures there, or for a local minimum",
    )
