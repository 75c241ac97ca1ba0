"""Graphs with edges or nodes added, removed or renamed: only what is new is checked."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from operator import index
from typing import TYPE_CHECKING, Any, TypeAlias

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

Renaming: TypeAlias = int | Mapping[int, int] | Callable[[int], int]


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
    return _restructured(
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
    return _restructured(graph, structure)


def relabel(graph: PoseGraph, to: Renaming) -> PoseGraph:
    """See `PoseGraph.relabel`."""
    old, n = graph.structure, len(graph.ids)
    every = np.concatenate([graph.ids, graph.point_ids])
    new = _renamed(every, to)
    _refuse_twins(every, new, n)
    nodes, points = new[:n], new[n:]
    order = np.argsort(nodes, kind="stable")
    structure = Structure(
        nodes[order],
        nodes[graph.edge_indices].reshape(-1, 2),
        np.sort(nodes[graph.index(graph.fixed)]),
        graph.dof,
        nodes[graph.index(old.roots)],
    )
    in_order = bool((order[1:] > order[:-1]).all())
    if in_order:
        structure.share_connectivity(old)
    poses = graph.poses if in_order or graph.poses is None else graph.poses[order]
    stamps = graph.stamps if in_order or graph.stamps is None else graph.stamps[order]
    landmarks, priors = graph.landmarks, graph.priors
    if landmarks is not None:
        order = np.argsort(points, kind="stable")
        landmarks = replace(
            landmarks,
            ids=points[order],
            positions=None if landmarks.positions is None else landmarks.positions[order],
            observations=new[_indices(every, landmarks.observations)],
        )
    if priors is not None:
        priors = priors.renamed(new[_indices(every, priors.ids)])
    return _restructured(
        graph, structure, poses=poses, stamps=stamps, landmarks=landmarks, priors=priors
    )


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
    return _restructured(
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


def _restructured(graph: PoseGraph, structure: Structure, **arrays: Any) -> PoseGraph:
    """Return the graph with another structure and other arrays."""
    return replace(
        graph,
        ids=structure.ids,
        edges=structure.edges,
        fixed=structure.fixed,
        structure=structure,
        **arrays,
    )


def _renamed(ids: Ids, to: Renaming) -> Ids:
    """Return the new id of each node and landmark."""
    if isinstance(to, Mapping):
        keys = list(to)
        out = ids.copy()
        values = checks.integers("new ids", [to[k] for k in keys])
        if values.shape != (len(keys),):
            raise GraphError("new ids must be one integer for each node")
        out[_indices(ids, checks.integers("ids", keys))] = values
        return out
    if callable(to):
        out = checks.integers("new ids", [to(node) for node in ids.tolist()])
        if out.ndim != 1:
            raise GraphError("new ids must be one integer for each node")
        return out
    return shifted(ids, to)


def _refuse_twins(old: Ids, new: Ids, poses: int) -> None:
    """Refuse new ids that are the same; the first ones are those of the poses."""
    order = np.argsort(new, kind="stable")
    for k in np.flatnonzero(np.diff(new[order]) == 0)[:1]:
        a, b = order[k : k + 2]
        what = "nodes" if b < poses else "landmarks" if a >= poses else "node and the landmark"
        raise GraphError(f"the {what} {old[a]} and {old[b]} would both get the id {new[a]}")


def _indices(ids: Ids, wanted: Ids) -> Ids:
    """Return the indices of wanted ids, of any shape, among ids in any order."""
    order = np.argsort(ids, kind="stable")
    indices: Ids = order[np.searchsorted(ids, wanted, sorter=order).clip(max=len(ids) - 1)]
    for node in wanted[ids[indices] != wanted][:1]:
        raise GraphError(f"the graph has no node {node}")
    return indices


def shifted(ids: Ids, offset: int) -> Ids:
    """Return ids plus an offset; a sum of more than 64 bits is a GraphError."""
    if isinstance(offset, bool | np.bool_) or not hasattr(offset, "__index__"):
        raise GraphError(f"an offset of ids must be an integer, got {offset!r:.40}")
    step = index(offset)
    if ids.size and not -(2**63) <= int(ids.min()) + step <= int(ids.max()) + step < 2**63:
        raise GraphError(
            f"the ids {ids.min()} to {ids.max()} shifted by {step} do not fit in 64 bits: "
            "give them smaller ids with `relabel` first"
        )
    # The offset itself may need 65 bits.
    half = step // 2
    return ids + half + (step - half)
