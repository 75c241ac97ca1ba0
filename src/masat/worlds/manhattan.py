"""The Manhattan world: a random walk on a unit grid, as in M3500."""

from __future__ import annotations

import numpy as np

from masat.errors import GraphError
from masat.graph import PoseGraph
from masat.worlds.closures import check_size, generator
from masat.worlds.streets import street_world, walk

# Quarter turns to the left before each step; relative frequencies as in M3500.
_TURNS = np.array([0, 1, 3, 2])
_FREQUENCIES = np.array([0.764, 0.078, 0.079, 0.079])
_EDGES_PER_NODE = 5453 / 3500
# Poses a square meter where closures are few, and for each closure a pose. Spread evenly, poses of
# this density offer more than twice the closures wanted.
_DENSITY = 1.0


def manhattan(
    nodes: int = 3500, edges: int | None = None, *, extent: int | None = None, seed: int = 0
) -> PoseGraph:
    """Simulate a walk on a square unit grid with loop closures where it meets its own track.

    Each step leads one meter ahead, to the left, to the right or back, and the robot faces the way
    it went; the frequencies are those of M3500 (Olson, Leonard, Teller, Fast iterative alignment of
    pose graphs with poor initial estimates, 2006). A wall turns it back. Loop closures are drawn
    at random among the pairs of poses at most one meter apart.

    Parameters
    ----------
    nodes : int
        Number of poses.
    edges : int, optional
        Number of measurements, nodes - 1 of them odometry. Default: the share of M3500, 5453 for
        3500 nodes; Manhattan10000 has 64311 for 10000.
    extent : int, optional
        Side of the square, meters. Default: one that offers the loop closures asked for.
    seed : int
        Of the random numbers.

    Returns
    -------
    PoseGraph
        The truth: exact poses and measurements, identity information. Perturb it with
        `masat.worlds.perturb`.

    Raises
    ------
    GraphError
        If there are fewer than two nodes, fewer edges than odometry needs, or more than the walk
        offers.
    """
    check_size(nodes, edges)
    usual = round(_EDGES_PER_NODE * nodes)
    if extent is None:
        density = max(_DENSITY, ((edges or usual) - nodes) / nodes)
        extent = max(1, round((nodes / density) ** 0.5) - 1)
    if extent < 1:
        raise GraphError(f"a walk needs an extent of a meter, got {extent} m")
    random = generator(seed)
    turns = random.choice(_TURNS, size=nodes - 1, p=_FREQUENCIES)
    return street_world(walk(np.column_stack([turns, turns + 2]), extent), edges, usual, random)
