"""The city world: a drive along blocks, with turns at crossings, as in City10k."""

from __future__ import annotations

import numpy as np

from masat.errors import GraphError
from masat.graph import PoseGraph
from masat.worlds.closures import check_integers, check_size, generator
from masat.worlds.streets import street_world, walk

# Quarter turns to the left at a crossing, and their relative frequencies in City10k.
_TURNS = np.array([0, 1, 3])
_FREQUENCIES = np.array([0.774, 0.113, 0.113])
_EDGES_PER_NODE = 20687 / 10000
# Poses per meter of street: at least as many as in City10k, more where more closures per pose are
# asked for. Poses of this density, spread evenly, offer about twice the closures asked for.
_DENSITY, _PER_CLOSURE = 2.2, 1.5


def city(
    nodes: int = 10000,
    edges: int | None = None,
    *,
    block: int = 5,
    extent: int | None = None,
    seed: int = 0,
) -> PoseGraph:
    """Simulate a drive through the streets of a city, with loop closures at revisited streets.

    Each step is one meter long. The robot turns only at crossings, to the left or to the right, as
    often as in City10k (Kaess, Ranganathan, Dellaert, iSAM: Incremental smoothing and mapping,
    2008), and at the border of the city. It faces its direction of travel. Loop closures are drawn
    at random from the pairs of poses at most one meter apart.

    Parameters
    ----------
    nodes : int
        Number of poses.
    edges : int, optional
        Number of measurements, nodes - 1 of them odometry. Default: as many per node as in
        City10k, 20687 for 10000 nodes.
    block : int
        Distance between crossings, meters.
    extent : int, optional
        Side of the square city in meters, rounded down to whole blocks. Default: a side with which
        the drive offers enough loop closures.
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
    check_integers(block=block, extent=block if extent is None else extent)
    if block < 1 or (extent is not None and extent < block):
        side = "" if extent is None else f" in an extent of {extent} m"
        raise GraphError(
            "a city has at least one block, and a block is at least 1 m long; got a block of "
            f"{block} m{side}"
        )
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
    return street_world(np.repeat(headings, min(block, nodes))[: nodes - 1], edges, usual, random)
