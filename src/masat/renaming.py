"""Graphs with other ids of nodes and landmarks."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from operator import index
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from masat import _checks as checks
from masat.arrays import Ids
from masat.editing import restructured
from masat.errors import GraphError
from masat.structure import Structure

if TYPE_CHECKING:
    from masat.graph import PoseGraph

Renaming: TypeAlias = int | Mapping[int, int] | Callable[[int], int]


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
    return restructured(
        graph, structure, poses=poses, stamps=stamps, landmarks=landmarks, priors=priors
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
