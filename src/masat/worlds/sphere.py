"""The sphere world: a spiral from pole to pole, as in sphere2500."""

from __future__ import annotations

import numpy as np

from masat.graph import PoseGraph
from masat.worlds.closures import check_size, draw, generator, lagged, truth
from masat.worlds.frames import facing


def sphere(nodes: int = 2500, edges: int | None = None, *, seed: int = 0) -> PoseGraph:
    """Simulate a drive over a sphere, along a spiral with as many turns as it has poses per turn.

    Each step is one meter long at the equator. Loop closures join each pose to the one a full turn
    before, as in sphere2500 (Kaess et al., iSAM2, 2012). The robot faces along the spiral, its z
    axis points outward.

    Parameters
    ----------
    nodes : int
        Number of poses.
    edges : int, optional
        Number of measurements, nodes - 1 of them odometry, the others drawn at random from the
        loop closures to the turn before; if they do not suffice, also from those to the neighbors
        of that pose. Default: all loop closures to the turn before, 4949 edges for 2500 nodes.
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
    turn = max(4, round(nodes**0.5))
    k = np.arange(nodes)
    around, down = 2 * np.pi * k / turn, np.pi * (k + 0.5) / nodes
    outward = np.column_stack(
        [np.sin(down) * np.cos(around), np.sin(down) * np.sin(around), np.cos(down)]
    )
    poses = facing(outward * turn / (2 * np.pi), outward)
    loops = lagged(nodes, [turn])
    if edges is not None and edges - (nodes - 1) > len(loops):
        loops = lagged(nodes, [turn - 1, turn, turn + 1])
    return truth(poses, loops[draw(len(loops), nodes, edges, 2 * nodes, generator(seed))])
