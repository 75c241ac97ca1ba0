"""The grid world: a walk through all of a cubic lattice, as in grid3D."""

from __future__ import annotations

import numpy as np

from masat.arrays import Ids
from masat.graph import PoseGraph
from masat.worlds.closures import check_size, draw, generator, on_lattice, truth
from masat.worlds.frames import facing


def grid(nodes: int = 8000, edges: int | None = None, *, seed: int = 0) -> PoseGraph:
    """Simulate a walk through a cubic unit lattice, row by row and layer by layer, to and fro.

    Each place is visited once. Loop closures are to neighbors one meter apart, as in grid3D
    (Carlone et al., Initialization techniques for 3D SLAM, 2015). The robot faces the way it goes.

    Parameters
    ----------
    nodes : int
        Number of poses; the cube is full where this is one.
    edges : int, optional
        Number of measurements, nodes - 1 of them odometry, the others drawn at random from the
        loop closures. Default: all, so 22800 for 8000 nodes; grid3D has 22236.
    seed : int
        Of the random numbers.

    Returns
    -------
    PoseGraph
        The truth: exact poses and measurements, identity information.

    Raises
    ------
    GraphError
        If there are fewer than two nodes, fewer edges than odometry needs, or more than offered.
    """
    check_size(nodes, edges)
    places = _rows(nodes)
    near = on_lattice(places)
    loops = near.pairs(draw(near.count, nodes, edges, 3 * nodes, generator(seed)))
    points = places.astype(np.float64)
    up = np.tile([0.0, 0.0, 1.0], (nodes, 1))
    climbs = np.diff(points[:, 2], append=points[-1, 2]) > 0
    climbs[-1] = climbs[-2]  # the last faces as the one before
    up[climbs] = [-1.0, 0.0, 0.0]
    return truth(facing(points, up), loops)


def _rows(nodes: int) -> Ids:
    """Return the first places, (n, 3), of a cube's rows, every other one reversed."""
    side = 1
    while side**3 < nodes:
        side += 1
    k = np.arange(nodes)
    row, layer = k // side, k // side**2
    x, y = k % side, row % side
    y = np.where(layer % 2, side - 1 - y, y)
    return np.column_stack([np.where(row % 2, side - 1 - x, x), y, layer])
