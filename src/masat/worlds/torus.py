"""The torus world: a coil around a ring, as in torus3D."""

from __future__ import annotations

import numpy as np

from masat.graph import PoseGraph
from masat.worlds.closures import check_size, draw, generator, lagged, truth
from masat.worlds.frames import facing

_EDGES_PER_NODE = 9048 / 5000


def torus(nodes: int = 5000, edges: int | None = None, *, seed: int = 0) -> PoseGraph:
    """Simulate a drive over a torus, along a coil around its tube that goes once along the ring.

    Each step is about one meter long, and so is the distance between turns along the middle of the
    tube; the ring is twice as wide as the tube. The robot faces along the coil, its z axis points
    outward. Loop closures join each pose to the one a full turn before, and the last turn to the
    first, as in torus3D (Carlone et al., Initialization techniques for 3D SLAM, 2015).

    Parameters
    ----------
    nodes : int
        Number of poses.
    edges : int, optional
        Number of measurements, nodes - 1 of them odometry, the others drawn at random from the
        loop closures; if they do not suffice, also from those to the neighbors of these poses.
        Default: as many per node as in torus3D, 9048 for 5000 nodes.
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
    usual = round(_EDGES_PER_NODE * nodes)
    turn = max(4, round((nodes / 2) ** 0.5))
    k = np.arange(nodes)
    along, around = 2 * np.pi * k / nodes, 2 * np.pi * k / turn
    radius = turn / (2 * np.pi)
    ring = np.column_stack([np.cos(along), np.sin(along), np.zeros(nodes)])
    outward = ring * np.cos(around)[:, None] + np.sin(around)[:, None] * [0, 0, 1]
    poses = facing(radius * (2 * ring + outward), outward)
    # A whole number of turns, so that the last pose meets the first at the same side of the tube.
    full = (nodes - 1) // turn * turn
    loops = lagged(nodes, [turn, full])
    if edges is not None and edges - (nodes - 1) > len(loops):
        loops = lagged(nodes, [turn - 1, turn, turn + 1, full])
    return truth(poses, loops[draw(len(loops), nodes, edges, usual, generator(seed))])
