"""The true graph of a grid world, recovered from its noisy measurements."""

from __future__ import annotations

import numpy as np

from masat.arrays import Floats, Ids
from masat.errors import GraphError
from masat.graph import PoseGraph
from masat.initializers import initialize
from masat.lie import between
from masat.optimizers import optimize

_CELL = np.array([1, 1, np.pi / 2])
# Longer steps are clipped, so that sums of them fit in 64 bits; the check of the edges then fails.
_MAX_STEP = 2**31
# Root mean square deviation in cells. It is 0.289 for measurements that lie on no grid; noise above
# 0.2 moves one of 80 measurements to a neighboring cell.
_MAX_DEVIATION = 0.2
_COS = np.array([1, 0, -1, 0])
_SIN = np.array([0, 1, 0, -1])


def recover_grid_truth(graph: PoseGraph) -> PoseGraph:
    """Recover the true graph of a world on the unit grid.

    The graph is optimized, each step from a node to the next is rounded to whole meters and quarter
    turns, and the steps are added up in integers. Every measurement must then differ by less than
    half a cell and half a quarter turn from the true one: after a wrong step, the loop closures
    over it would differ by a whole one. The root mean square deviation must be at most 0.2 of a
    cell and of a quarter turn.

    Parameters
    ----------
    graph : PoseGraph
        A graph in 2D with an edge between each node and the next. Its poses are not used.

    Returns
    -------
    PoseGraph
        The same nodes and edges with exact poses in the frame of the first node, exact
        measurements, and identity information. Lengths are integers, angles multiples of pi/2 in
        (-pi, pi].

    Raises
    ------
    GraphError
        If the graph is not 2D, lacks an edge between a node and the next, or is not on the grid.
        The message names the first edge that does not fit and its deviation (measured minus true),
        or the root mean square deviation.
    """
    if graph.dimension != 2:
        raise GraphError("the grid worlds are 2D, but this graph is 3D")
    _check_chain(graph)
    truth = _add_up(_steps(graph))
    start, end = (truth[graph.edge_indices[:, k]] for k in (0, 1))
    exact = _between(start, end)
    _check_edges(graph, exact)
    return PoseGraph.from_arrays(
        graph.edges,
        _metric(exact),
        ids=graph.ids,
        poses=_metric(truth),
        fixed=graph.fixed.tolist(),
    )


def _check_chain(graph: PoseGraph) -> None:
    first = graph.edge_indices.min(axis=1)
    consecutive = np.abs(np.diff(graph.edge_indices, axis=1)[:, 0]) == 1
    gaps = np.setdiff1d(np.arange(len(graph.ids) - 1), first[consecutive])
    for k in gaps[:1]:
        raise GraphError(
            f"the odometry is not complete: no edge joins node {graph.ids[k]} to {graph.ids[k + 1]}"
            + (f", and {len(gaps) - 1} more are missing" if len(gaps) > 1 else "")
        )


def _steps(graph: PoseGraph) -> Ids:
    """Return the steps between consecutive nodes, (n - 1, 3), in meters and quarter turns."""
    # Without the graph's poses and fixed nodes, which would distort the map.
    bare = PoseGraph.from_arrays(graph.edges, graph.measurements, graph.information, ids=graph.ids)
    poses = optimize(initialize(bare)).poses
    cells = np.rint(between(poses[:-1], poses[1:]) / _CELL)
    steps: Ids = cells.clip(-_MAX_STEP, _MAX_STEP).astype(np.int64)
    return steps


def _add_up(steps: Ids) -> Ids:
    """Return the poses before and after each step, (n, 3), beginning at the origin."""
    poses = np.zeros((len(steps) + 1, 3), np.int64)
    poses[1:, 2] = np.cumsum(steps[:, 2])
    poses[1:, :2] = np.cumsum(_turned(steps[:, :2], poses[:-1, 2]), axis=0)
    return poses


def _between(start: Ids, end: Ids) -> Ids:
    """Return the poses `end`, (m, 3), in the frames of the poses `start`."""
    moved = end - start
    moved[:, :2] = _turned(moved[:, :2], -start[:, 2])
    return moved


def _turned(vectors: Ids, quarters: Ids) -> Ids:
    """Return vectors, (m, 2), rotated by quarter turns, (m,)."""
    c, s = _COS[quarters % 4], _SIN[quarters % 4]
    x, y = vectors.T
    return np.column_stack([c * x - s * y, s * x + c * y])


def _check_edges(graph: PoseGraph, exact: Ids) -> None:
    """Check that every measurement rounds to the exact one, (m, 3), and their mean deviation."""
    deviation = graph.measurements / _CELL - exact
    deviation[:, 2] -= 4 * np.rint(deviation[:, 2] / 4)
    for k in np.flatnonzero((np.abs(deviation) >= 0.5).any(axis=1))[:1].tolist():
        x, y, theta = deviation[k] * _CELL
        raise GraphError(
            f"not a world on the unit grid: edge {k} ({graph.edges[k, 0]} -> {graph.edges[k, 1]}) "
            f"is off by {x:.3g} m, {y:.3g} m and {theta:.3g} rad; half a cell is 0.5 m and "
            f"{np.pi / 4:.3g} rad",
            edge=k,
        )
    # Without loop closures, every edge agrees with its own rounding, even if there is no grid.
    spread = np.sqrt((deviation**2).mean(axis=0)) if len(deviation) else np.zeros(3)
    if (spread > _MAX_DEVIATION).any():
        x, y, theta = spread * _CELL
        raise GraphError(
            "not a world on the unit grid: the measurements are spread over its cells, with a root "
            f"mean square deviation of {x:.3g} m, {y:.3g} m and {theta:.3g} rad"
        )
    if len(exact) and not exact[:, :2].any():
        raise GraphError("not a world on the unit grid: no edge leads to another cell")


def _metric(cells: Ids) -> Floats:
    """Return meters and radians in (-pi, pi] from meters and quarter turns."""
    return np.column_stack([cells[:, :2], (np.pi / 2) * ((cells[:, 2] + 1) % 4 - 1)])
