"""Parts of a graph that the trusted edges leave unconnected."""

from __future__ import annotations

import numpy as np

from masat.arrays import Ids
from masat.initializers import guess_of
from masat.robust.closures import GATE, Closures
from masat.robust.growth import spokesmen
from masat.robust.prediction import agreement


def joining_closures(closures: Closures) -> Ids:
    """Return closures that join the parts of the trusted edges, one for each connection.

    Nothing predicts a closure between two parts before another one joins them. Of the groups that
    agree, the largest joins first; its closure that agrees with most others is taken.

    Parameters
    ----------
    closures : Closures
        The closures.

    Returns
    -------
    ndarray of int64
        Indices in `closures.graph.edges`.
    """
    graph = closures.graph
    trusted = graph.without_edges(~closures.trusted)
    labels = trusted.components
    if labels.max() == graph.components.max():
        return np.empty(0, np.int64)
    poses = guess_of(trusted, "odometry").poses
    assert poses is not None
    of_ends = labels[closures.ends]
    between = np.flatnonzero(of_ends[:, 0] != of_ends[:, 1])
    pairs = closures.pairs[np.isin(closures.pairs, between).all(axis=1)]
    agree = pairs[agreement(closures, poses, pairs) < GATE[graph.dof]]
    group = spokesmen(len(closures), agree)
    size = np.bincount(group[between], minlength=len(closures))
    chosen: list[int] = []
    parts = labels
    order = between[np.lexsort((between, group[between] != between, -size[group[between]]))]
    for k in order.tolist():
        a, b = parts[closures.ends[k]]
        if a != b:
            chosen.append(k)
            parts = np.where(parts == b, a, parts)
    return closures.edges[np.array(chosen, np.int64)]
