"""Graphs with edges or nodes added or removed: only what is new is checked."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from masat import _checks as checks
from masat import _core, lie
from masat.arrays import Flags, Floats, Ids, Indices, Labels, Stamps
from masat.errors import GraphError
from masat.measurements import joined
from masat.stamps import joined_stamps, node_stamps
from masat.structure import Structure

if TYPE_CHECKING:
    from masat.graph import PoseGraph


def with_edges(
    graph: PoseGraph,
    edges: ArrayLike,
    measurements: ArrayLike,
    information: ArrayLike | None = None,
    *,
    labels: ArrayLike | None = None,
    ids: ArrayLike | None = None,
    poses: ArrayLike | None = None,
    stamps: ArrayLike | None = None,
) -> PoseGraph:
    """See `PoseGraph.with_edges`."""
    size = lie.POSE_SIZE[graph.dimension]
    pairs = checks.pairs_of_ids(edges)
    z = checks.table("measurements", measurements)
    z = z.reshape(0, size) if z.shape[1] == 0 else z
    if z.shape != (len(pairs), size):
        raise GraphError(
            f"measurements must have shape ({len(pairs)}, {size}) to go with the edges and the "
            f"graph, got {z.shape}"
        )
    new_ids, new_poses = _new_nodes(graph, pairs, ids, poses)
    new_stamps = _new_stamps(graph, new_ids, stamps)
    for node in new_ids[np.isin(new_ids, graph.point_ids)][:1]:
        raise GraphError(f"the id {node} is that of a landmark: choose another for the new node")
    nodes = np.concatenate([graph.ids, new_ids])
    order = np.argsort(nodes, kind="stable")
    nodes = nodes[order]
    checks.known_edges(nodes, pairs)
    z = checks.rotations(z, "measurement", pairs, "edge")
    matrices = checks.information_matrices(information, pairs, graph.dof)
    given = checks.edge_labels(labels, len(pairs))
    structure = Structure(
        nodes if len(new_ids) else graph.ids,
        np.concatenate([graph.edges, pairs]),
        graph.fixed,
        graph.dof,
        graph.structure.roots,
    )
    all_measurements = np.concatenate([graph.measurements, z])
    all_poses = graph.poses
    if graph.poses is not None and len(new_ids):
        rows = np.tile(lie.identity(graph.dimension), (len(new_ids), 1))
        if new_poses is not None:
            rows = new_poses
        all_poses = np.concatenate([graph.poses, rows])[order]
        if new_poses is None:
            placed = np.flatnonzero(order < len(graph.ids)).astype(np.int32)
            all_poses = _with_rest_placed(structure, placed, all_measurements, all_poses)
    structure.check_fixed(all_poses)
    return restructured(
        graph,
        structure,
        poses=all_poses,
        measurements=all_measurements,
        information=np.concatenate([graph.information, matrices]),
        labels=joined_labels([(graph.labels, len(graph.edges)), (given, len(pairs))]),
        stamps=new_stamps if new_stamps is None else new_stamps[order],
    )


def without_edges(graph: PoseGraph, which: ArrayLike) -> PoseGraph:
    """See `PoseGraph.without_edges`."""
    m = len(graph.edges)
    mask = checks.flags(which)
    if mask is not None:
        if mask.shape != (m,):
            raise GraphError(f"a mask of edges must have shape ({m},), got {mask.shape}")
        return _with_rows(graph, ~mask)
    indices = checks.row_of_integers("the indices of edges", which)
    for k in indices[(indices < 0) | (indices >= m)][:1]:
        raise GraphError(f"there is no edge {k}: the graph has {m} edges, counted from 0")
    keep = np.ones(m, np.bool_)
    keep[indices] = False
    return _with_rows(graph, keep)


def without_nodes(graph: PoseGraph, ids: int | Iterable[int]) -> PoseGraph:
    """See `PoseGraph.without_nodes`."""
    removed = checks.row_of_integers("ids", ids)
    keep = np.ones(len(graph.ids), np.bool_)
    keep[graph.index(removed)] = False
    if not keep.any():
        raise GraphError("a graph needs a node: not all nodes can be removed")
    start, end = graph.edge_indices.T
    return _with_rows(graph, keep[start] & keep[end], keep)


def with_fixed(graph: PoseGraph, fixed: int | Iterable[int]) -> PoseGraph:
    """See `PoseGraph.with_fixed`."""
    chosen = checks.row_of_integers("fixed", fixed)
    checks.known_nodes(graph.ids, chosen, "fixed node")
    old = graph.structure
    structure = Structure(old.ids, old.edges, chosen, old.dof, old.roots)
    structure.share_connectivity(old)
    structure.check_fixed(graph.poses)
    return restructured(graph, structure)


def joined_labels(parts: list[tuple[Labels | None, int]]) -> Labels | None:
    """Return the labels of edges that come in parts, given those of each and its edge count.

    Edges without a label get -1 among integers and the empty string among strings.
    """
    kinds = {labels.dtype.kind for labels, _ in parts if labels is not None}
    if not kinds:
        return None
    if len(kinds) > 1:
        raise GraphError("labels must be all integers or all strings, as those of the graph are")
    missing: Any = np.array([""] if "U" in kinds else [-1])
    filled = [np.repeat(missing, n) if labels is None else labels for labels, n in parts]
    out: Labels = np.concatenate(filled)
    return out


def _new_nodes(
    graph: PoseGraph, pairs: Ids, ids: ArrayLike | None, poses: ArrayLike | None
) -> tuple[Ids, Floats | None]:
    """Return the ids that are not in the graph, in the order given, and their poses."""
    if ids is None:
        named = checks.distinct(pairs)
        nodes = named[~checks.among(graph.ids, named)]
    else:
        nodes = checks.node_ids(ids)
        for node in nodes[checks.among(graph.ids, nodes)][:1]:
            raise GraphError(f"node {node} is in the graph already: name only new nodes in `ids`")
        checks.ascending(nodes, None)
    if poses is None:
        return nodes, None
    if graph.poses is None:
        raise GraphError("the graph has no poses, so its new nodes can have none")
    size = lie.POSE_SIZE[graph.dimension]
    given = checks.table("poses", poses)
    if given.shape != (len(nodes), size) and (len(nodes) or given.size):
        raise GraphError(
            f"poses must have shape ({len(nodes)}, {size}) to go with the new nodes, got "
            f"{given.shape}"
        )
    return nodes, checks.rotations(given.reshape(-1, size), "pose", nodes, "node")


def _new_stamps(graph: PoseGraph, nodes: Ids, stamps: ArrayLike | None) -> Stamps | None:
    """Return the stamps of the graph's nodes and of the new ones, in this order."""
    given = node_stamps(stamps, nodes)
    if graph.stamps is None and given is not None:
        raise GraphError(
            "the graph has no stamps, so its new nodes can have none: give it stamps first, with "
            "`with_stamps`"
        )
    if graph.stamps is not None and given is None and len(nodes):
        raise GraphError(
            f"the graph has stamps, so its new node {nodes[0]} needs one: give `stamps`, or remove "
            "all stamps with `with_stamps(None)`"
        )
    return graph.stamps if given is None else joined_stamps([graph.stamps, given])


def _with_rest_placed(
    structure: Structure, placed: Indices, measurements: Floats, poses: Floats
) -> Floats:
    """Return the poses, those of the other nodes found by the measurements, breadth first."""
    reached = np.zeros(len(structure.ids), np.bool_)
    reached[structure.components[placed]] = True
    for node in structure.ids[~reached[structure.components]][:1]:
        raise GraphError(
            f"no edges lead from the nodes of the graph to the new node {node}: give `poses`"
        )
    out, _ = _core.place_along_tree(
        structure.topology, placed, np.empty(0, np.bool_), measurements, poses
    )
    return out


def _with_rows(graph: PoseGraph, edges: Flags, nodes: Flags | None = None) -> PoseGraph:
    """Return the graph with only these edges and nodes."""
    old = graph.structure
    structure = Structure(
        old.ids if nodes is None else old.ids[nodes],
        old.edges[edges],
        old.fixed if nodes is None else old.fixed[nodes[old.index(old.fixed)]],
        old.dof,
        old.roots if nodes is None else old.roots[nodes[old.index(old.roots)]],
    )
    return restructured(
        graph,
        structure,
        **_measurements_of(graph, nodes),
        poses=graph.poses if nodes is None or graph.poses is None else graph.poses[nodes],
        measurements=graph.measurements[edges],
        information=graph.information[edges],
        labels=None if graph.labels is None else graph.labels[edges],
        stamps=graph.stamps if nodes is None or graph.stamps is None else graph.stamps[nodes],
    )


def _measurements_of(graph: PoseGraph, nodes: Flags | None) -> dict[str, Any]:
    """Return the priors and the observations of the nodes that remain, given by a mask."""
    if nodes is None:
        return {}
    gone = graph.ids[~nodes]
    out: dict[str, Any] = {}
    if graph.priors is not None:
        out["priors"] = joined([graph.priors.rows(~np.isin(graph.priors.ids, gone))])
    if graph.landmarks is not None:
        seen = graph.landmarks
        out["landmarks"] = seen.observed(~np.isin(seen.observations[:, 0], gone))
    return out


def restructured(graph: PoseGraph, structure: Structure, **arrays: Any) -> PoseGraph:
    """Return the graph with another structure and other arrays."""
    return replace(
        graph,
        ids=structure.ids,
        edges=structure.edges,
        fixed=structure.fixed,
        structure=structure,
        **arrays,
    )
