"""Parts of a graph that are optimized while the rest is fixed."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from masat import _core
from masat.arrays import Flags, Floats, Ids
from masat.graph import PoseGraph
from masat.optimizers.translations import BestTranslations


class Subgraph(NamedTuple):
    """Some nodes of a graph, free to move, and their neighbors, fixed.

    Attributes
    ----------
    graph : PoseGraph
        The graph of these nodes, k of them.
    nodes : ndarray of int, (k,)
        Their indices in the whole graph.
    edges : ndarray of int, (l,)
        The indices of its edges there, in ascending order.
    inside : ndarray of bool, (k,)
        Which nodes are free.
    equations : NormalEquations or None
        Those of `graph`, where they are known.
    translations : BestTranslations or None
        Those of `graph`, where they are known.
    """

    graph: PoseGraph
    nodes: Ids
    edges: Ids
    inside: Flags
    equations: _core.NormalEquations | None = None
    translations: BestTranslations | None = None


def neighborhood(graph: PoseGraph, nodes: Flags, steps: int = 1) -> Flags:
    """Return the nodes, (n,), that are at most so many edges away from some nodes."""
    out = nodes.copy()
    for _ in range(steps):
        out[graph.edge_indices[graph.topology.incident_edges(out)]] = True
    return out


def subgraph(graph: PoseGraph, poses: Floats, inside: Flags) -> Subgraph:
    """Return the subgraph in which some nodes are free, at poses of the whole graph."""
    edges = graph.topology.incident_edges(inside)
    ends = graph.edge_indices[edges].astype(np.int64)
    nodes = np.unique(ends)
    more: dict[str, Any] = {}
    if graph.sensor_offsets is not None:
        more["offsets"] = np.ascontiguousarray(graph.sensor_offsets[edges])
    return Subgraph(
        type(graph)(
            ids=nodes,
            poses=poses[nodes],
            edges=ends,
            measurements=np.ascontiguousarray(graph.measurements[edges]),
            information=np.ascontiguousarray(graph.information[edges]),
            fixed=nodes[~inside[nodes]],
            **more,
        ),
        nodes,
        edges,
        inside[nodes],
    )


def whole(
    graph: PoseGraph,
    poses: Floats,
    equations: _core.NormalEquations | None = None,
    translations: BestTranslations | None = None,
) -> Subgraph:
    """Return the whole graph at some poses, with its gauge fixed."""
    inside = np.ones(len(poses), np.bool_)
    inside[graph.index(graph.gauge)] = False
    nodes = np.arange(len(poses), dtype=np.int64)
    edges = np.arange(len(graph.edges), dtype=np.int64)
    return Subgraph(graph.with_poses(poses), nodes, edges, inside, equations, translations)


def without_edges(graph: PoseGraph, edges: Flags) -> PoseGraph:
    """Return the graph without some edges, (m,), and with all its nodes."""
    kept = np.flatnonzero(~edges)
    more: dict[str, Any] = {}
    if graph.sensor_offsets is not None:
        more["offsets"] = np.ascontiguousarray(graph.sensor_offsets[kept])
    return type(graph)(
        ids=graph.ids,
        poses=graph.poses,
        edges=graph.edges[kept],
        measurements=graph.measurements[kept],
        information=graph.information[kept],
        fixed=graph.fixed,
        **more,
    )


def connected_parts(graph: PoseGraph, nodes: Flags) -> Iterator[Flags]:
    """Yield the parts of some nodes, (n,) each, that edges among them connect."""
    edges = graph.topology.incident_edges(nodes)
    edges = edges[nodes[graph.edge_indices[edges]].all(axis=1)]
    indices = np.flatnonzero(nodes)
    if len(indices) == 0:
        return
    ends = np.searchsorted(indices, graph.edge_indices[edges]).astype(np.int32)
    part_of = _core.Topology(len(indices), np.ascontiguousarray(ends)).components()
    for part in range(part_of.max() + 1):
        own = np.zeros_like(nodes)
        own[indices[part_of == part]] = True
        yield own
