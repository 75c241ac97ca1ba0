"""A graph as a front end would have given it: pose by pose, each with its edges to earlier ones."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from time import perf_counter
from typing import NamedTuple

import numpy as np

from masat.arrays import Floats, Ids
from masat.graph import PoseGraph
from masat.groups import Groups
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
        Indices of its priors, and of those of the landmarks that it is the first to see.
    observations : ndarray of int64, (l,)
        Indices of its observations of landmarks.
    """

    node: int
    edges: Ids
    priors: Ids
    observations: Ids


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

    Landmarks that no pose sees have no part in them, and their priors neither.
    """
    ends = graph.edge_indices
    newer, gap = ends.max(axis=1), np.abs(np.diff(ends, axis=1))[:, 0]
    order = np.lexsort((gap != 1, newer))
    begin = np.searchsorted(newer[order], np.arange(len(graph) + 1))
    seen, priors = graph.landmarks, graph.priors
    poses = np.zeros(0, np.int64) if seen is None else graph.index(seen.observations[:, 0])
    observations, priors_of = Groups(poses, len(graph)), Groups(np.zeros(0, np.int64), len(graph))
    if priors is not None:
        at = np.full(len(priors), len(graph))
        on_pose = np.isin(priors.ids, graph.ids)
        at[on_pose] = graph.index(priors.ids[on_pose])
        if seen is not None and len(poses):
            by_pose = np.argsort(poses, kind="stable")
            points, first = np.unique(seen.observations[by_pose, 1], return_index=True)
            known = ~on_pose & np.isin(priors.ids, points)
            at[known] = poses[by_pose][first][np.searchsorted(points, priors.ids[known])]
        priors_of = Groups(at, len(graph) + 1)
    for k, node in enumerate(graph.ids.tolist()):
        edges = order[begin[k] : begin[k + 1]].astype(np.int64)
        yield Step(node, edges, priors_of.of(k), observations.of(k))


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
    for k, (node, edges, priors, observations) in enumerate(steps(graph)):
        start = perf_counter()
        online.add_pose(node)
        if len(edges):
            numbers[edges] = online.add_edges(
                graph.edges[edges], graph.measurements[edges], graph.information[edges]
            )
        if len(observations) and graph.landmarks is not None:
            seen = graph.landmarks.observed(observations)
            points = np.unique(seen.observations[:, 1])
            online.add_observations(replace(seen, ids=points, positions=None))
        if len(priors) and graph.priors is not None:
            online.add_priors(graph.priors.rows(priors))
        online.update(budget)
        _ = online.poses
        seconds[k] = perf_counter() - start
        if report is not None:
            report(k + 1, online)
    return Replay(online, numbers, seconds)
