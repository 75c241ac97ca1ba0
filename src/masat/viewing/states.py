"""The maps that the slider of a view goes through: before, at each iteration, and the result."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from masat import lie
from masat.arrays import Floats, Ids
from masat.errors import GraphError
from masat.graph import PoseGraph
from masat.plotting import before_and_after

# More maps than this make a slider that nobody reads; more bytes of positions and chi2 than this
# make the file of a large graph too large. A few are kept of any graph.
_MOST_STATES, _FEWEST_STATES = 60, 8
_MAX_BYTES = 1_400_000
_BYTES_PER_NUMBER = 4


class State(NamedTuple):
    """A map that is drawn.

    Attributes
    ----------
    title : str
        What it is, such as "iteration 3 of 8".
    poses : ndarray, (n, 3) or (n, 7)
        The poses, in the order of the ids.
    """

    title: str
    poses: Floats


def states_of(
    graph: PoseGraph, before: Mapping[str, PoseGraph], iterations: Iterable[ArrayLike]
) -> list[State]:
    """Return the maps to draw, the graph's own one last.

    Parameters
    ----------
    graph : PoseGraph
        The graph at the poses of the result.
    before : mapping of str to PoseGraph
        Earlier maps of the same nodes. One without poses is drawn by its odometry. Each component
        is moved so that its gauge-fixed node lies where it lies in the result.
    iterations : iterable of array_like, (n, 3) or (n, 7)
        The poses of the initial guess and then those after each iteration. If there are many, some
        between the first and the last are left out.

    Raises
    ------
    GraphError
        If the nodes or the shapes of the poses differ from those of the graph.
    """
    assert graph.poses is not None
    states = [_earlier(title, other, graph) for title, other in before.items()]
    recorded = [_checked(graph, poses, k) for k, poses in enumerate(iterations)]
    last = len(recorded) - 1
    for k in _chosen(len(recorded), _affordable(graph) - len(states) - 1):
        title = "initial guess" if k == 0 else f"iteration {k} of {last}"
        states.append(State(title, recorded[k]))
    if recorded and np.array_equal(recorded[-1], graph.poses):
        states.pop()
    states.append(State("result" if states else "map", graph.poses))
    return states


def moved_onto(graph: PoseGraph, poses: Floats) -> Floats:
    """Return other poses of a graph, with its gauge-fixed nodes where the graph has them.

    Components that fixed nodes or priors place are not moved.
    """
    assert graph.poses is not None
    gauge = np.setdiff1d(graph.gauge, graph.fixed)
    if len(gauge) == 0:
        return poses
    at = graph.index(gauge)
    moves = np.tile(lie.identity(graph.dimension), (int(graph.components.max()) + 1, 1))
    moves[graph.components[at]] = lie.compose(graph.poses[at], lie.inverse(poses[at]))
    return lie.compose(moves[graph.components], poses)


def _earlier(title: str, other: PoseGraph, graph: PoseGraph) -> State:
    if not np.array_equal(other.ids, graph.ids) or other.dimension != graph.dimension:
        raise GraphError(
            f"the map {title!r} has other nodes than the one that is drawn: {len(other)} in "
            f"{other.dimension}D instead of {len(graph)} in {graph.dimension}D"
        )
    (name, drawn), *_ = before_and_after(other, graph).items()
    assert isinstance(drawn, PoseGraph)
    assert drawn.poses is not None
    if drawn is other:
        return State(title, moved_onto(graph, drawn.poses))
    return State(name.removeprefix("before: "), moved_onto(graph, drawn.poses))


def _checked(graph: PoseGraph, poses: ArrayLike, k: int) -> Floats:
    array = np.asarray(poses, np.float64)
    assert graph.poses is not None
    if array.shape != graph.poses.shape:
        raise GraphError(
            f"the poses of iteration {k} have shape {array.shape}, expected {graph.poses.shape}: "
            "record them with report_poses of masat.solve"
        )
    return array


def _affordable(graph: PoseGraph) -> int:
    """Return how many maps a view of a graph may hold."""
    numbers = len(graph) * graph.dimension + len(graph.edges)
    affordable = _MAX_BYTES // max(_BYTES_PER_NUMBER * numbers, 1)
    return int(np.clip(affordable, _FEWEST_STATES, _MOST_STATES))


def _chosen(count: int, limit: int) -> Ids:
    """Return which of some iterations to keep: the first, the last, and more at the beginning."""
    limit = max(limit, 2)
    if count <= limit:
        return np.arange(count)
    wanted = np.geomspace(1, count, limit).round().astype(np.int64)
    # The first numbers of the sequence coincide: they are moved on to the next ones.
    for k in range(1, limit):
        wanted[k] = max(wanted[k], wanted[k - 1] + 1)
    return wanted - 1
