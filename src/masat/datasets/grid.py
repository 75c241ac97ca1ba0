"""The truth of a grid world, recovered from its noisy measurements."""

from __future__ import annotations

import numpy as np

from masat.arrays import Floats, Ids
from masat.errors import GraphError
from masat.graph import PoseGraph
from masat.initializers import initialize
from masat.lie import between
from masat.optimizers import optimize

_CELL = np.array([1, 1, np.pi / 2])
# Steps that sum up in 64 bits; a longer one is refused with the edges that it does not fit.
_FARTHEST = 2**31
# In cells. Off any grid it is 0.289; sigmas above 0.2 put every 80th edge into the next cell.
_LARGEST_SPREAD = 0.2
_COS = np.array([1, 0, -1, 0])
_SIN = np.array([0, 1, 0, -1])


def recover_grid_truth(graph: PoseGraph) -> PoseGraph:
    """Recover the truth of a world on the unit grid.

    The graph is optimized from MASAT, each step from a node to the next is rounded to meters and
    quarter turns, and the steps are added up in integers. Every measurement must then lie less
    than half a cell and half a quarter turn from the truth; a single wrong step would put the loop
    closures over it a whole one off. Their root mean square deviation must be at most 0.2 of a
    cell or of a quarter turn.

    Parameters
    ----------
    graph : PoseGraph
        A planar graph with an edge between each node and the next. Its poses do not count.

    Returns
    -------
    PoseGraph
        The same nodes and edges; poses in the frame of the first node and measurements, both exact:
        integers and multiples of pi/2 in (-pi, pi]. Identity information.

    Raises
    ------
    GraphError
        If the graph is not planar, lacks an edge of the chain, or is not on the grid: the first
        edge that is off, and by how much (measured less true), or their spread.
    """
    if graph.dimension != 2:
        raise GraphError("only planar graphs have a grid world's truth, this one is 3D")
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
            f"the chain is not complete: no edge joins node {graph.ids[k]} to {graph.ids[k + 1]}"
            + (f", and {len(gaps) - 1} more are missing" if len(gaps) > 1 else "")
        )


def _steps(graph: PoseGraph) -> Ids:
    """Return the steps between consecutive nodes, (n - 1, 3): meters and quarter turns."""
    # Poses and fixed nodes of the graph's own would bend the map.
    bare = PoseGraph.from_arrays(graph.edges, graph.measurements, graph.information, ids=graph.ids)
    poses = optimize(initialize(bare)).poses
    cells = np.rint(between(poses[:-1], poses[1:]) / _CELL)
    steps: Ids = cells.clip(-_FARTHEST, _FARTHEST).astype(np.int64)
    return steps


def _add_up(steps: Ids) -> Ids:
    """Return the poses after each step, (n, 3), from the origin."""
    poses = np.zeros((len(steps) + 1, 3), np.int64)
    poses[1:, 2] = np.cumsum(steps[:, 2])
    poses[1:, :2] = np.cumsum(_turned(steps[:, :2], poses[:-1, 2]), axis=0)
    return poses


def _between(start: Ids, end: Ids) -> Ids:
    """Return the poses `end` as seen from `start`, (m, 3)."""
    moved = end - start
    moved[:, :2] = _turned(moved[:, :2], -start[:, 2])
    return moved


def _turned(vectors: Ids, quarters: Ids) -> Ids:
    c, s = _COS[quarters % 4], _SIN[quarters % 4]
    x, y = vectors.T
    return np.column_stack([c * x - s * y, s * x + c * y])


def _check_edges(graph: PoseGraph, exact: Ids) -> None:
    """Demand that every measurement rounds to the exact one, (m, 3), and all lie about it."""
    off = graph.measurements / _CELL - exact
    off[:, 2] -= 4 * np.rint(off[:, 2] / 4)
    for k in np.flatnonzero((np.abs(off) >= 0.5).any(axis=1))[:1].tolist():
        x, y, theta = off[k] * _CELL
        raise GraphError(
            f"not a world on the unit grid: edge {k} ({graph.edges[k, 0]} -> {graph.edges[k, 1]}) "
            f"is off by {x:.3g} m, {y:.3g} m and {theta:.3g} rad; half a cell is 0.5 m and "
            f"{np.pi / 4:.3g} rad",
            edge=k,
        )
    # Without loop closures every edge agrees with its own rounding, on a grid or not.
    spread = np.sqrt((off**2).mean(axis=0)) if len(off) else np.zeros(3)
    if (spread > _LARGEST_SPREAD).any():
        x, y, theta = spread * _CELL
        raise GraphError(
            f"not a world on the unit grid: the measurements are spread over its cells, by {x:.3g} "
            f"m, {y:.3g} m and {theta:.3g} rad"
        )
    if len(exact) and not exact[:, :2].any():
        raise GraphError("not a world on the unit grid: no edge leads to another cell")


def _metric(cells: Ids) -> Floats:
    """Return meters and radians in (-pi, pi] for meters and quarter turns."""
    return np.column_stack([cells[:, :2], (np.pi / 2) * ((cells[:, 2] + 1) % 4 - 1)])
