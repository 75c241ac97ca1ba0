"""The odometry of a graph."""

from __future__ import annotations

import numpy as np

from masat.arrays import Flags, Ids
from masat.graph import PoseGraph


def odometry_edges(graph: PoseGraph) -> Flags:
    """Return which edges are odometry, (m,): the first one between each pair of consecutive ids.

    The last node of a session and the first one of the next are not consecutive.
    """
    lower, upper = np.sort(graph.edge_indices, axis=1).T
    consecutive = upper - lower == 1
    begins = graph.structure.session_begins
    if len(begins):
        consecutive &= ~np.isin(upper, begins)
    consecutive = np.flatnonzero(consecutive)
    _, first = np.unique(lower[consecutive], return_index=True)
    chain = np.zeros(len(lower), np.bool_)
    chain[consecutive[first]] = True
    return chain


def sessions(graph: PoseGraph) -> Ids:
    """Return the session that each node belongs to, (n,), counted from 0 in the order of the ids.

    A session begins where the ids jump by more than 10,000 times the steps before and after, as
    they do in what `masat.merge` returns, in all files and edits made of it, and in graphs whose
    ids begin with the letter of a robot (gtsam's symbols).

    Parameters
    ----------
    graph : PoseGraph
        The graph.

    Returns
    -------
    ndarray of int64, (n,)

    Examples
    --------
    >>> import masat
    >>> graph = masat.PoseGraph.from_arrays([(0, 1), (5000000, 5000001)], [(1, 0, 0)] * 2)
    >>> masat.sessions(graph).tolist()
    [0, 0, 1, 1]
    """
    begins = np.zeros(len(graph), np.int64)
    begins[graph.structure.session_begins] = 1
    return np.cumsum(begins)
