"""Walks along the streets of a square grid, and their graphs, exact to the last bit."""

from __future__ import annotations

import numpy as np

from masat.arrays import Floats, Ids
from masat.graph import PoseGraph
from masat.lie import between
from masat.worlds.closures import draw, in_time, on_lattice

_STEPS = np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])


def walk(turns: Ids, extent: int) -> Ids:
    """Return the headings of a walk that walls turn back.

    Parameters
    ----------
    turns : ndarray of int64, (n, k)
        Quarter turns to the left before each step; of k choices the first that leads into no wall
        is taken, or else the last.
    extent : int
        Side of the square around the origin, steps.

    Returns
    -------
    ndarray of int64, (n,)
        Headings of the steps in quarter turns, [0, 4).
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
    """Return the truth of a walk from the origin, with loop closures of at most one meter.

    Parameters
    ----------
    headings : ndarray of int64, (n - 1,)
        Headings of the steps of one meter, quarter turns; the robot faces the way it went.
    edges, usual : int
        Number of measurements, as in `draw`.
    random : Generator
        Draws the closures.
    """
    nodes = len(headings) + 1
    places = np.concatenate([[[0, 0]], np.cumsum(_STEPS[headings], axis=0)])
    near = on_lattice(places)
    loops = near.pairs(draw(near.count, nodes, edges, usual, random))
    pairs = in_time(nodes, loops)
    poses = np.column_stack([places, _wrapped(np.concatenate([[0], headings]))])
    exact = _rounded(between(poses[pairs[:, 0]], poses[pairs[:, 1]]))
    return PoseGraph.from_arrays(pairs, exact, poses=poses, ids=np.arange(nodes))


def _wrapped(quarters: Ids) -> Floats:
    turns: Floats = ((quarters + 2) % 4 - 2).astype(np.float64)
    return turns * (np.pi / 2)


def _rounded(measurements: Floats) -> Floats:
    """Round to the grid what trigonometry left beside it."""
    quarters = np.rint(measurements[:, 2] / (np.pi / 2)).astype(np.int64)
    return np.column_stack([np.rint(measurements[:, :2]) + 0.0, _wrapped(quarters)])
