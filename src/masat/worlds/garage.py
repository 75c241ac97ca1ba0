"""The garage world: storeys above each other, joined by ramps, as in parking-garage."""

from __future__ import annotations

import numpy as np

from masat.arrays import Floats
from masat.errors import GraphError
from masat.graph import PoseGraph
from masat.worlds.closures import check_integers, check_size, draw, generator, truth, within
from masat.worlds.frames import facing

_EDGES_PER_NODE = 6275 / 1661
_LAPS = 2  # per storey
_HEIGHT = 3.0  # meters from storey to storey
_RAMP = 24  # steps of a ramp, one full circle
_REACH = 3.2  # meters that a loop closure spans at most: one storey down and one step along


def garage(
    nodes: int = 1661, edges: int | None = None, *, storeys: int = 5, seed: int = 0
) -> PoseGraph:
    """Simulate a drive up a parking garage: two laps on each storey, then a winding ramp.

    Each step is one meter long, each storey three meters high. The robot faces its direction of
    travel, and pitches on the ramps. Loop closures are drawn at random from the pairs of poses at
    most 3.2 m apart with at least half a lap of driving between them. They join the laps of a
    storey, and a storey to the one below, as in parking-garage (Kuemmerle et al., g2o, 2011).

    Parameters
    ----------
    nodes : int
        Number of poses; it determines the length of the laps.
    edges : int, optional
        Number of measurements, nodes - 1 of them odometry. Default: as many per node as in
        parking-garage, 6275 for 1661 nodes.
    storeys : int
        Largest number of storeys; a graph of few nodes has fewer.
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
    check_integers(storeys=storeys)
    if storeys < 1:
        raise GraphError(f"a garage has at least one storey, got {storeys}")
    half_lap = max(9, -(-(-(-nodes // storeys) - _RAMP) // (2 * _LAPS)))
    points = _drive(nodes, half_lap)
    near = within(points, _REACH, gap=half_lap)
    loops = near[draw(len(near), nodes, edges, usual, generator(seed))]
    return truth(facing(points, np.array([0.0, 0.0, 1.0])), loops)


def _drive(nodes: int, half_lap: int) -> Floats:
    """Return the points, (n, 3): laps around a rectangle, then a rising circle beside it."""
    depth = half_lap // 3
    width = half_lap - depth
    steps = np.repeat([[1, 0], [0, 1], [-1, 0], [0, -1]], [width, depth, width, depth], axis=0)
    lap = np.cumsum(steps, axis=0) - steps
    k = np.arange(_RAMP)
    radius = _RAMP / (2 * np.pi)
    around = 2 * np.pi * k / _RAMP
    ramp = np.column_stack([radius * (np.cos(around) - 1), -radius * np.sin(around)])
    storey = np.column_stack(
        [np.concatenate([*[lap] * _LAPS, ramp]), np.zeros(_LAPS * len(lap) + _RAMP)]
    )
    storey[-_RAMP:, 2] = _HEIGHT * k / _RAMP
    level, index = np.divmod(np.arange(nodes), len(storey))
    points: Floats = storey[index] + level[:, None] * [0.0, 0.0, _HEIGHT]
    return points
