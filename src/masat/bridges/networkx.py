"""networkx: the graph as a `MultiDiGraph`, for its algorithms on paths, cuts and communities."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from masat.bridges.packages import package
from masat.errors import GraphError
from masat.graph import PoseGraph


def to_networkx(graph: PoseGraph) -> Any:
    """Return a graph as a `networkx.MultiDiGraph`, without loss.

    Parameters
    ----------
    graph : PoseGraph
        The graph.

    Returns
    -------
    networkx.MultiDiGraph
        Nodes are the ids, with the attributes `pose`, `stamp` and `fixed`. The key of an edge is
        its index; its attributes are `measurement`, `information`, `label`, and `length`, the
        measured distance in meters, as a weight for shortest paths. Attributes that the graph has
        no values for are missing. `dimension`, `notes`, `priors` and `landmarks` are attributes of
        the graph: landmarks are no nodes of it.

    Raises
    ------
    MasatError
        If networkx is not installed.
    """
    networkx = package("networkx", "networkx")
    out = networkx.MultiDiGraph(
        dimension=graph.dimension,
        notes=graph.notes,
        priors=graph.priors,
        landmarks=graph.landmarks,
    )
    fixed = set(graph.fixed.tolist())
    for k, node in enumerate(graph.ids.tolist()):
        about: dict[str, Any] = {"fixed": node in fixed}
        if graph.poses is not None:
            about["pose"] = graph.poses[k]
        if graph.stamps is not None:
            about["stamp"] = graph.stamps[k]
        out.add_node(node, **about)
    lengths = np.linalg.norm(graph.measurements[:, : graph.dimension], axis=1)
    for k, (a, b) in enumerate(graph.edges.tolist()):
        about = {
            "measurement": graph.measurements[k],
            "information": graph.information[k],
            "length": float(lengths[k]),
        }
        if graph.labels is not None:
            about["label"] = graph.labels[k].item()
        out.add_edge(a, b, key=k, **about)
    return out


def from_networkx(other: Any) -> PoseGraph:
    """Return a directed networkx graph as a graph.

    Parameters
    ----------
    other : networkx.MultiDiGraph or networkx.DiGraph
        Nodes are integers. Each edge has the attribute `measurement`, the pose of its second node
        in the frame of the first. The other attributes that `to_networkx` describes may be missing:
        information is then the identity. Edges of which all have integer keys that differ, as
        `to_networkx` makes them, are taken in the order of the keys, others in that of networkx.

    Returns
    -------
    PoseGraph

    Raises
    ------
    GraphError
        If the graph is undirected, a node is no integer, an edge has no measurement, or only some
        nodes or edges have an attribute. It names the first of them.
    """
    if not other.is_directed():
        raise GraphError(
            "an undirected graph does not tell which way its edges were measured: use a DiGraph or "
            "a MultiDiGraph"
        )
    nodes = list(other.nodes(data=True))
    for node, _ in nodes:
        if isinstance(node, bool) or not isinstance(node, int | np.integer):
            raise GraphError(
                f"the node {node!r:.60} is no integer: rename the nodes, such as with "
                "networkx.convert_node_labels_to_integers"
            )
    edges = _edges(other)
    names = [f"edge {a} -> {b}" for a, b, _ in edges]
    about = [row for _, _, row in edges]
    of_nodes = [row for _, row in nodes]
    nodes_named = [f"node {node}" for node, _ in nodes]
    measurements = _column(about, "measurement", names)
    if edges and measurements is None:
        raise GraphError(f"{names[0]} has no attribute 'measurement'")
    return PoseGraph.from_arrays(
        np.array([(a, b) for a, b, _ in edges], np.int64).reshape(-1, 2),
        measurements if measurements is not None else np.empty((0, _pose_size(other, of_nodes))),
        _column(about, "information", names),
        ids=[node for node, _ in nodes],
        poses=_column(of_nodes, "pose", nodes_named),
        fixed=[node for node, row in nodes if row.get("fixed", False)],
        stamps=_column(of_nodes, "stamp", nodes_named),
        labels=_column(about, "label", names),
        notes=other.graph.get("notes", ()),
        priors=other.graph.get("priors"),
        landmarks=other.graph.get("landmarks"),
    )


def _edges(other: Any) -> list[tuple[int, int, Mapping[str, Any]]]:
    if not other.is_multigraph():
        return list(other.edges(data=True))
    found = list(other.edges(keys=True, data=True))
    keys = [key for _, _, key, _ in found]
    if all(isinstance(key, int) for key in keys) and len(set(keys)) == len(keys):
        found.sort(key=lambda edge: edge[2])
    return [(a, b, row) for a, b, _, row in found]


def _column(rows: list[Mapping[str, Any]], name: str, names: list[str]) -> list[Any] | None:
    """Return an attribute of all nodes or edges, or None if no one has it."""
    has = [name in row for row in rows]
    if not any(has):
        return None
    if not all(has):
        raise GraphError(f"{names[has.index(False)]} has no attribute {name!r}, but others have")
    return [row[name] for row in rows]


def _pose_size(other: Any, nodes: list[Mapping[str, Any]]) -> int:
    """Return 3 or 7 for a graph without edges."""
    for row in nodes:
        if "pose" in row:
            return len(row["pose"])
    return 7 if other.graph.get("dimension", 2) == 3 else 3
