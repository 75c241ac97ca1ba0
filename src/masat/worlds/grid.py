"""The grid world: a walk through all points of a cubic lattice, as in grid3D."""

from __future__ import annotations

import numpy as np

from masat.arrays import Ids
from masat.graph import PoseGraph
from masat.worlds.closures import check_size, draw, generator, on_lattice, truth
from masat.worlds.frames import facing


def grid(nodes: int = 8000, edges: int | None = None, *, seed: int = 0) -> PoseGraph:
    """Simulate a walk through a cubic unit lattice, row by row and layer by layer.

    Each point is visited once; every other row is walked in the opposite direction. Loop closures
    join neighbors one meter apart, as in grid3D (Carlone et al., Initialization techniques for 3D
    SLAM, 2015). The robot faces its direction of travel.

    Parameters
    ----------
    nodes : int
        Number of poses; a cube number fills the cube.
    edges : int, optional
        Number of measurements, nodes - 1 of them odometry, the others drawn at random from the
        loop closures. Default: all of them, 22800 edges for 8000 nodes; grid3D has 22236.
    seed : int
        Seed of the random numbers.

    Returns
    -------
    PoseGraph
        The truth: exact poses and measurements, identity information.

    Raises
    ------
    GraphError
        If a size is not an integer, there are fewer than two nodes or fewer edges than odometry
        needs, or the walk offers too few loop closures.
    """
    check_size(nodes, edges)
    cells = _rows(nodes)
    near = on_lattice(cells)
    loops = near.pairs(draw(near.count, nodes, edges, 3 * nodes, generator(seed)))
    points = cells.astype(np.float64)
    up = np.tile([0.0, 0.0, 1.0], (nodes, 1))
    climbs = np.diff(points[:, 2], append=points[-1, 2]) > 0
    climbs[-1] = climbs[-2]  # the last pose faces as the one before
    up[climbs] = [-1.0, 0.0, 0.0]
    return truth(facing(points, up), loops)


def _rows(nodes: int) -> Ids:
    """Return the first n cells of a cube, (n, 3), row by row, every other row reversed."""
    side = 1
    while side**3 < nodes:
        side += 1
    k = np.arange(nodes)
    row, layer = k // side, k // side**2
    x, y = k % side, row % side
    y = np.where(layer % 2, side - 1 - y, y)
    return np.column_stack([np.where(row % 2, side - 1 - x, x), y, layer])
