"""Parts of a graph, with the rest held still."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from masat import _core
from masat.arrays import Flags, Floats, Ids
from masat.graph import PoseGraph


class Region(NamedTuple):
    """Some nodes of a graph, free to move, and those that edges join to them, held still.

    Attributes
    ----------
    graph : PoseGraph
        Its ids are the places of its nodes, k of them, in the whole.
    inside : ndarray of bool, (k,)
        Which of its nodes are free.
    """

    graph: PoseGraph
    inside: Flags


class Surroundings:
    """Tells which edges and nodes lie around some nodes of a graph."""

    def __init__(self, graph: PoseGraph) -> None:
        self.graph = graph

    def edges_at(self, nodes: Flags) -> Ids:
        """Return the edges that touch some nodes, ascending."""
        return self.graph.topology.incident_edges(nodes)

    def around(self, nodes: Flags, steps: int = 1) -> Flags:
        """Return the nodes that lie at most so many edges from some."""
        out = nodes.copy()
        for _ in range(steps):
            out[self.graph.edge_indices[self.edges_at(out)]] = True
        return out

    def region(self, poses: Floats, inside: Flags) -> Region:
        """Return the region of some nodes, at poses of the whole graph."""
        graph = self.graph
        edges = self.edges_at(inside)
        nodes = np.unique(graph.edge_indices[edges]).astype(np.int64)
        return Region(
            PoseGraph(
                ids=nodes,
                poses=poses[nodes],
                edges=graph.edge_indices[edges].astype(np.int64),
                measurements=np.ascontiguousarray(graph.measurements[edges]),
                information=np.ascontiguousarray(graph.information[edges]),
                fixed=nodes[~inside[nodes]],
            ),
            inside[nodes],
        )

    def parts(self, nodes: Flags) -> Iterator[Flags]:
        """Yield some nodes, those together that edges between them join."""
        graph = self.graph
        edges = self.edges_at(nodes)
        edges = edges[nodes[graph.edge_indices[edges]].all(axis=1)]
        places = np.flatnonzero(nodes)
        if len(places) == 0:
            return
        ends = np.searchsorted(places, graph.edge_indices[edges]).astype(np.int32)
        part_of = _core.Topology(len(places), np.ascontiguousarray(ends)).components()
        for part in range(part_of.max() + 1):
            own = np.zeros_like(nodes)
            own[places[part_of == part]] = True
            yield own
