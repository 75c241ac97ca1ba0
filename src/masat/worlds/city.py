"""The city world: drives along blocks, with turns at crossings, as in City10k."""

from __future__ import annotations

import numpy as np

from masat.errors import GraphError
from masat.graph import PoseGraph
from masat.worlds.closures import check_size, generator
from masat.worlds.streets import street_world, walk

# Quarter turns to the left at a crossing; relative frequencies as in City10k.
_TURNS = np.array([0, 1, 3])
_FREQUENCIES = np.array([0.774, 0.113, 0.113])
_EDGES_PER_NODE = 20687 / 10000
# Poses a meter of street where closures are few, as in City10k, and for each closure a pose.
# Spread evenly, poses of this density offer about twice the closures wanted.
_DENSITY, _PER_CLOSURE = 2.2, 1.5


def city(
    nodes: int = 10000,
    edges: int | None = None,
    *,
    block: int = 5,
    extent: int | None = None,
    seed: int = 0,
) -> PoseGraph:
    """Simulate a drive through the streets of a city with loop closures where it comes again.

    Steps are of one meter. Only at crossings the robot turns, to the left or to the right, as often
    as in City10k (Kaess, Ranganathan, Dellaert, iSAM: Incremental smoothing and mapping, 2008);
    where the city ends it turns to a side. It faces the way it went. Loop closures are drawn at
    random among the pairs of poses at most one meter apart.

    Parameters
    ----------
    nodes : int
        Number of poses.
    edges : int, optional
        Number of measurements, nodes - 1 of them odometry. Default: the share of City10k, 20687
        for 10000 nodes.
    block : int
        From crossing to crossing, meters.
    extent : int, optional
        Side of the square, meters; only whole blocks are built. Default: one that offers the loop
        closures asked for.
    seed : int
        Of the random numbers.

    Returns
    -------
    PoseGraph
        The truth: exact poses and measurements, identity information.

    Raises
    ------
    GraphError
        If there are fewer than two nodes, fewer edges than odometry needs, or more than the drive
        offers.
    """
    check_size(nodes, edges)
    usual = round(_EDGES_PER_NODE * nodes)
    if block < 1 or (extent is not None and extent < block):
        raise GraphError(f"a city needs a block, of a meter at least, got {block} of {extent} m")
    if extent is None:
        density = max(_DENSITY, _PER_CLOSURE * ((edges or usual) - nodes) / nodes)
        # The streets of a square of side e are 2 e (e / block + 1) long.
        streets = nodes / density
        extent = block * max(1, round(((1 + 2 * streets / block) ** 0.5 - 1) / 2))
    random = generator(seed)
    crossings = -(-(nodes - 1) // block)
    turns = random.choice(_TURNS, size=crossings, p=_FREQUENCIES)
    sides = random.choice([1, 3], size=crossings)
    headings = walk(np.column_stack([turns, sides, sides + 2]), extent // block)
    return street_world(np.repeat(headings, block)[: nodes - 1], edges, usual, random)
