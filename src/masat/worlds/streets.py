"""Walks along the streets of a square grid, and their graphs without any rounding errors."""

from __future__ import annotations

import numpy as np

from masat.arrays import Floats, Ids
from masat.graph import PoseGraph
from masat.lie import between
from masat.worlds.closures import draw, in_time, on_lattice

_STEPS = np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])


def walk(turns: Ids, extent: int) -> Ids:
    """Return the headings of a walk within walls.

    Parameters
    ----------
    turns : ndarray of int64, (n, k)
        Quarter turns to the left before each step. Of the k choices the walk takes the first that
        does not lead into a wall, or else the last.
    extent : int
        Side of the square around the origin, in steps.

    Returns
    -------
    ndarray of int64, (n,)
        Headings of the steps in quarter turns, in [0, 4).
    """
    low, high = -(extent // 2), extent - extent // 2
    steps = [tuple(step) for step in _STEPS.tolist()]
    headings = []
    x = y = heading = 0
    for choices in turns.tolist():
        for turn in choices:
            taken = (heading + turn) % 4
            dx, dy = steps[taken]
            if low <= x + dx <= high and low <= y + dy <= high:
                break
        x, y, heading = x + dx, y + dy, taken
        headings.append(heading)
    return np.array(headings, np.int64)


def street_world(
    headings: Ids, edges: int | None, usual: int, random: np.random.Generator
) -> PoseGraph:
    """Return the true graph of a walk from the origin, with loop closures of at most one meter.

    Parameters
    ----------
    headings : ndarray of int64, (n - 1,)
        Headings of the steps in quarter turns; each step is one meter long.
    edges, usual : int
        Number of measurements, as in `draw`.
    random : Generator
        Generator that draws the loop closures.

    Returns
    -------
    PoseGraph
        Exact poses, which face the direction of travel, and exact measurements.
    """
    nodes = len(headings) + 1
    cells = np.concatenate([[[0, 0]], np.cumsum(_STEPS[headings], axis=0)])
    near = on_lattice(cells)
    loops = near.pairs(draw(near.count, nodes, edges, usual, random))
    pairs = in_time(nodes, loops)
    poses = np.column_stack([cells, _wrapped(np.concatenate([[0], headings]))])
    exact = _rounded(between(poses[pairs[:, 0]], poses[pairs[:, 1]]))
    return PoseGraph.from_arrays(pairs, exact, poses=poses, ids=np.arange(nodes))


def _wrapped(quarters: Ids) -> Floats:
    turns: Floats = ((quarters + 2) % 4 - 2).astype(np.float64)
    return turns * (np.pi / 2)


def _rounded(measurements: Floats) -> Floats:
    """Remove the rounding errors of trigonometry: all measurements lie on the grid."""
    quarters = np.rint(measurements[:, 2] / (np.pi / 2)).astype(np.int64)
    return np.column_stack([np.rint(measurements[:, :2]) + 0.0, _wrapped(quarters)])
