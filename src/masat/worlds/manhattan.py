"""The Manhattan world: a random walk on a unit grid, as in M3500."""

from __future__ import annotations

import numpy as np

from masat.arrays import Floats, Ids
from masat.errors import GraphError
from masat.graph import PoseGraph
from masat.lie import between

# Quarter turns to the left after each step; relative frequencies as in M3500.
_TURNS = np.array([0, 1, 3, 2])
_FREQUENCIES = np.array([0.764, 0.078, 0.079, 0.079])
_STEPS = np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])


def manhattan(
    nodes: int = 3500, edges: int = 5500, *, extent: int = 60, seed: int = 0
) -> PoseGraph:
    """Simulate a walk on a square unit grid with loop closures where it meets its own track.

    Each step leads one metre ahead, to the left, to the right or back, and the robot faces the way
    it went; the frequencies are those of M3500 (Olson, Leonard, Teller, Fast iterative alignment of
    pose graphs with poor initial estimates, 2006). A wall turns it back. Loop closures are drawn
    at random among the pairs of poses at most one metre apart.

    Parameters
    ----------
    nodes : int
        Number of poses.
    edges : int
        Number of measurements, nodes - 1 of them odometry.
    extent : int
        Side of the square, metres.
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
    if nodes < 2 or edges < nodes - 1 or extent < 1:
        raise GraphError(
            "a walk needs two nodes, an edge less than nodes and an extent of a metre, got "
            f"{nodes} nodes, {edges} edges and {extent} m"
        )
    random = np.random.default_rng(seed)
    places, headings = _walk(nodes, extent, random)
    poses = np.column_stack([places, _wrapped(headings)]).astype(np.float64)
    chain = np.column_stack([np.arange(nodes - 1), np.arange(1, nodes)])
    near = _near_pairs(places)
    wanted = edges - (nodes - 1)
    if wanted > len(near):
        raise GraphError(
            f"the walk offers {len(near)} loop closures, {wanted} were asked for: make the extent "
            "smaller or the walk longer"
        )
    loops = near[np.sort(random.choice(len(near), wanted, replace=False))]
    # In the order of time: a closure is measured when its second pose is reached.
    pairs = np.concatenate([chain, loops])
    pairs = pairs[np.lexsort((pairs[:, 0] != pairs[:, 1] - 1, pairs[:, 1]))]
    exact = _exact(between(poses[pairs[:, 0]], poses[pairs[:, 1]]))
    return PoseGraph.from_arrays(pairs, exact, poses=poses, ids=np.arange(nodes))


def _walk(nodes: int, extent: int, random: np.random.Generator) -> tuple[Ids, Ids]:
    """Return the places, (n, 2), and headings in quarter turns, (n,), from the origin."""
    turns = random.choice(_TURNS, size=nodes, p=_FREQUENCIES)
    places = np.zeros((nodes, 2), np.int64)
    headings = np.zeros(nodes, np.int64)
    low, high = -(extent // 2), extent - extent // 2
    x = y = heading = 0
    steps = [tuple(step) for step in _STEPS.tolist()]
    for k, turn in enumerate(turns[1:].tolist(), 1):
        heading = (heading + turn) % 4
        dx, dy = steps[heading]
        if not (low <= x + dx <= high and low <= y + dy <= high):
            heading = (heading + 2) % 4
            dx, dy = -dx, -dy
        x, y = x + dx, y + dy
        places[k] = x, y
        headings[k] = heading
    return places, headings


def _near_pairs(places: Ids) -> Ids:
    """Return the pairs (i, j), i < j - 1, of poses at most one metre apart, ascending."""
    span = int(np.ptp(places, axis=0).max()) + 3
    cells = (places - places.min(axis=0) + 1) @ np.array([span, 1])
    order = np.argsort(cells, kind="stable")
    ordered = cells[order]
    found = []
    for offset in (0, 1, -1, span, -span):
        first = np.searchsorted(ordered, cells + offset, "left")
        count = np.searchsorted(ordered, cells + offset, "right") - first
        one = np.repeat(np.arange(len(cells)), count)
        within = np.arange(len(one)) - np.repeat(np.cumsum(count) - count, count)
        found.append(np.column_stack([one, order[np.repeat(first, count) + within]]))
    pairs = np.concatenate(found)
    pairs = pairs[pairs[:, 0] < pairs[:, 1] - 1]
    return pairs[np.lexsort((pairs[:, 0], pairs[:, 1]))]


def _wrapped(quarters: Ids) -> Floats:
    turns: Floats = ((quarters + 2) % 4 - 2).astype(np.float64)
    return turns * (np.pi / 2)


def _exact(measurements: Floats) -> Floats:
    """Round to the grid what trigonometry left beside it."""
    quarters = np.rint(measurements[:, 2] / (np.pi / 2)).astype(np.int64)
    return np.column_stack([np.rint(measurements[:, :2]) + 0.0, _wrapped(quarters)])
