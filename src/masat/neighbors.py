"""How well neighboring loop closures agree, whatever the map is like."""

from __future__ import annotations

import numpy as np

from masat import _core, lie
from masat.arrays import Flags, Floats, Ids
from masat.chain import odometry_edges
from masat.graph import PoseGraph
from masat.quantiles import TENTH

# Loop closures are neighbors if both their ends lie in the same block of this many nodes.
_BLOCK = 10
# Fewer pairs of neighbors tell nothing.
_MIN_PAIRS = 20


def neighbor_scale(graph: PoseGraph) -> float | None:
    """Return by which factor the errors of neighboring loop closures exceed their information.

    Two loop closures and the odometry between their ends make a short cycle, which must close
    within the uncertainty of its edges. Of all these cycles the best tenth counts: most loop
    closures may be false, and poses are not needed. The variances are added up roughly and rather
    too large: in simulated noise the factor is a ninth of the reduced chi2 of the map or more, on
    public graphs a hundredth in all but three, where neighbors have errors in common.

    Source: Mangelson, Dominic, Eustice, Vasudevan, Pairwise consistent measurement set
    maximization, ICRA 2018, who compare all pairs.

    Parameters
    ----------
    graph : PoseGraph
        The graph; it needs no poses.

    Returns
    -------
    float or None
        None if the graph has too few pairs of neighboring loop closures.
    """
    apart = np.abs(np.diff(graph.edge_indices, axis=1)).ravel() > 1
    closures = np.flatnonzero(apart)
    ends = graph.edge_indices[closures].astype(np.int64)
    z = graph.measurements[closures].copy()
    backward = ends[:, 0] > ends[:, 1]
    z[backward] = lie.inverse(z[backward])
    ends = np.sort(ends, axis=1)
    block = ends // _BLOCK
    order = np.lexsort((ends[:, 1], ends[:, 0], block[:, 1], block[:, 0]))
    first, second = order[:-1], order[1:]
    # Measurements of the same two nodes are often copies of each other.
    neighbors = (block[first] == block[second]).all(axis=1) & (ends[first] != ends[second]).any(1)
    if np.count_nonzero(neighbors) < _MIN_PAIRS:
        return None
    pairs = np.column_stack([first[neighbors], second[neighbors]])
    roots = graph.index(graph.gauge).astype(np.int32)
    poses = np.tile(lie.identity(graph.dimension), (len(graph), 1))
    chain = odometry_edges(graph)
    poses, _ = _core.place_along_tree(graph.topology, roots, chain, graph.measurements, poses)
    own = np.einsum("kii->ki", np.linalg.inv(graph.information[closures]))
    distance = cycle_distances(pairs, ends, z, own, poses, variance_along(graph, chain))
    return scale_of_best_tenth(distance, graph.dof)


def scale_of_best_tenth(distances: Floats, dof: int) -> float:
    """Return by which factor the best tenth of some squared distances exceed honest ones."""
    return float(np.quantile(distances, 0.1)) / TENTH[dof]


def cycle_distances(
    pairs: Ids, ends: Ids, measurements: Floats, variances: Floats, poses: Floats, along: Floats
) -> Floats:
    """Return about the chi2 of the cycles that pairs of loop closures make, (p,).

    The parameters are those of `cycle_residuals`.
    """
    e, variance = cycle_residuals(pairs, ends, measurements, variances, poses, along)
    distance: Floats = (np.square(e) / variance).sum(axis=1)
    return distance


def cycle_residuals(
    pairs: Ids, ends: Ids, measurements: Floats, variances: Floats, poses: Floats, along: Floats
) -> tuple[Floats, Floats]:
    """Return by how much the cycles of pairs of loop closures do not close, and its variances.

    Parameters
    ----------
    pairs : ndarray of int, (p, 2)
        Pairs of loop closures.
    ends : ndarray of int, (c, 2)
        Indices of the nodes of each closure, the earlier one first.
    measurements : ndarray, (c, 3) or (c, 7)
        The pose of the second as seen from the first.
    variances : ndarray, (c, 3) or (c, 6)
        Variances of the measurements.
    poses : ndarray, (n, 3) or (n, 7)
        Poses; of a pair, only those of the first ends are compared, and those of the second ends.
    along : ndarray, (n, 3) or (n, 6)
        Sums of the variances of odometry up to each node, as in `variance_along`.

    Returns
    -------
    residuals, variances : ndarray, (p, 3) or (p, 6)
    """
    i, j = pairs.T
    a, b = ends.T
    there = lie.between(poses[a[j]], poses[a[i]])
    back = lie.between(poses[b[i]], poses[b[j]])
    z = measurements
    e = lie.local(z[j], lie.compose(lie.compose(there, z[i]), back))
    variance = variances[i] + variances[j]
    variance += np.abs(along[a[j]] - along[a[i]]) + np.abs(along[b[j]] - along[b[i]])
    d = 2 if poses.shape[1] == 3 else 3
    # A rotation moves what is an arm's length away.
    arm = np.sum([np.linalg.norm(p[:, :d], axis=1) for p in (there, back, z[i])], axis=0)
    variance[:, :d] += (variance[:, d:].max(axis=1, initial=0) * np.square(arm))[:, None]
    return e, variance


def variance_along(graph: PoseGraph, trusted: Flags) -> Floats:
    """Return the sum of the variances of trusted edges up to each node, (n, dof).

    Only differences between nodes that trusted edges connect have a meaning.
    """
    steps = np.zeros((len(graph), graph.dof))
    later = graph.edge_indices[trusted].max(axis=1)
    np.maximum.at(steps, later, np.einsum("kii->ki", np.linalg.inv(graph.information[trusted])))
    # Nodes of several parts may alternate.
    order = np.argsort(graph.without_edges(~trusted).components, kind="stable")
    total = np.empty_like(steps)
    total[order] = np.cumsum(steps[order], axis=0)
    return total
