"""A graph as a front end would have given it: pose by pose, each with its edges to earlier ones."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from time import perf_counter
from typing import NamedTuple

import numpy as np

from masat.arrays import Floats, Ids
from masat.errors import GraphError
from masat.graph import PoseGraph
from masat.online.growing import TOLERANCE, OnlineMap


class Step(NamedTuple):
    """What arrives at once.

    Attributes
    ----------
    node : int
        The id of the new pose.
    edges : ndarray of int64, (k,)
        Indices of its edges to earlier poses, odometry first.
    priors : ndarray of int64, (p,)
        Indices of its priors.
    """

    node: int
    edges: Ids
    priors: Ids


class Replay(NamedTuple):
    """A map that was grown step by step.

    Attributes
    ----------
    map : OnlineMap
        The map after the last step.
    numbers : ndarray of int64, (m,)
        The number that each edge of the graph has in the map.
    seconds : ndarray, (n,)
        Wall time of each step: additions, update and reading all poses.
    """

    map: OnlineMap
    numbers: Ids
    seconds: Floats


def steps(graph: PoseGraph) -> Iterator[Step]:
    """Yield the steps in which a graph grows: its poses in the order of their ids.

    Raises
    ------
    GraphError
        If the graph has landmarks, which a map that grows does not hold yet.
    """
    if graph.landmarks is not None:
        raise GraphError("a map that grows holds no landmarks yet: leave them out")
    ends = graph.edge_indices
    newer, gap = ends.max(axis=1), np.abs(np.diff(ends, axis=1))[:, 0]
    order = np.lexsort((gap != 1, newer))
    begin = np.searchsorted(newer[order], np.arange(len(graph) + 1))
    priors: dict[int, list[int]] = {}
    for row, node in enumerate([] if graph.priors is None else graph.priors.ids.tolist()):
        priors.setdefault(node, []).append(row)
    for k, node in enumerate(graph.ids.tolist()):
        edges = order[begin[k] : begin[k + 1]].astype(np.int64)
        yield Step(node, edges, np.array(priors.get(node, []), np.int64))


def replay(
    graph: PoseGraph,
    *,
    tolerance: float = TOLERANCE,
    robust: bool = False,
    budget: float | None = None,
    report: Callable[[int, OnlineMap], None] | None = None,
) -> Replay:
    """Grow a map from the edges of a graph, in the order of the ids of its nodes.

    Parameters
    ----------
    graph : PoseGraph
        The graph; its poses do not count.
    tolerance, robust
        As of `OnlineMap`.
    budget : float, optional
        Seconds an update, as of `OnlineMap.update`.
    report : callable, optional
        Called after each step with the number of steps so far and the map.

    Raises
    ------
    GraphError, OptimizationError
        As of `steps` and of `OnlineMap`.
    """
    online = OnlineMap(graph.dimension, tolerance=tolerance, robust=robust)
    numbers = np.zeros(len(graph.edges), np.int64)
    seconds = np.zeros(len(graph))
    for k, (node, edges, priors) in enumerate(steps(graph)):
        start = perf_counter()
        online.add_pose(node)
        if len(edges):
            numbers[edges] = online.add_edges(
                graph.edges[edges], graph.measurements[edges], graph.information[edges]
            )
        if len(priors) and graph.priors is not None:
            online.add_priors(graph.priors.rows(priors))
        online.update(budget)
        _ = online.poses
        seconds[k] = perf_counter() - start
        if report is not None:
            report(k + 1, online)
    return Replay(online, numbers, seconds)
