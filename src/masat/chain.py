"""The odometry of a graph."""

from __future__ import annotations

import numpy as np

from masat.arrays import Flags
from masat.graph import PoseGraph


def odometry_edges(graph: PoseGraph) -> Flags:
    """Return which edges are odometry, (m,): the first one between each pair of consecutive ids."""
    lower, upper = np.sort(graph.edge_indices, axis=1).T
    consecutive = np.flatnonzero(upper - lower == 1)
    _, first = np.unique(lower[consecutive], return_index=True)
    chain = np.zeros(len(lower), np.bool_)
    chain[consecutive[first]] = True
    return chain
