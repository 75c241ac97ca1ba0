"""The Manhattan world: a random walk on a unit grid, as in M3500."""

from __future__ import annotations

import numpy as np

from masat.errors import GraphError
from masat.graph import PoseGraph
from masat.worlds.closures import check_integers, check_size, generator
from masat.worlds.streets import street_world, walk

# Quarter turns to the left before each step, and their relative frequencies in M3500.
_TURNS = np.array([0, 1, 3, 2])
_FREQUENCIES = np.array([0.764, 0.078, 0.079, 0.079])
_EDGES_PER_NODE = 5453 / 3500
# Poses per square meter, more where more closures per pose are asked for. Poses of this density,
# spread evenly, offer more than twice the closures asked for.
_DENSITY = 1.0


def manhattan(
    nodes: int = 3500, edges: int | None = None, *, extent: int | None = None, seed: int = 0
) -> PoseGraph:
    """Simulate a walk on a square unit grid, with loop closures where the walk meets its own track.

    Each step leads one meter ahead, to the left, to the right or back, as often as in M3500 (Olson,
    Leonard, Teller, Fast iterative alignment of pose graphs with poor initial estimates, 2006). The
    robot faces its direction of travel and turns back at a wall. Loop closures are drawn at random
    from the pairs of poses at most one meter apart.

    Parameters
    ----------
    nodes : int
        Number of poses.
    edges : int, optional
        Number of measurements, nodes - 1 of them odometry. Default: as many per node as in
        M3500, 5453 for 3500 nodes; Manhattan10000 has 64311 for 10000.
    extent : int, optional
        Side of the square in meters. Default: a side with which the walk offers enough loop
        closures.
    seed : int
        Seed of the random numbers.

    Returns
    -------
    PoseGraph
        The truth: exact poses and measurements, identity information. Perturb it with
        `masat.worlds.perturb`.

    Raises
    ------
    GraphError
        If a size is not an integer, there are fewer than two nodes or fewer edges than odometry
        needs, or the walk offers too few loop closures.
    """
    check_size(nodes, edges)
    usual = round(_EDGES_PER_NODE * nodes)
    if extent is None:
        density = max(_DENSITY, ((edges or usual) - nodes) / nodes)
        extent = max(1, round((nodes / density) ** 0.5) - 1)
    check_integers(extent=extent)
    if extent < 1:
        raise GraphError(f"the extent of a walk is at least 1 m, got {extent} m")
    random = generator(seed)
    turns = random.choice(_TURNS, size=nodes - 1, p=_FREQUENCIES)
    return street_world(walk(np.column_stack([turns, turns + 2]), extent), edges, usual, random)
