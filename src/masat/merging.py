"""Merging graphs, for example the sessions of one robot, into one graph."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from masat import _checks as checks
from masat.arrays import Flags, Ids, Indices
from masat.editing import joined_labels
from masat.errors import GraphError
from masat.graph import PoseGraph
from masat.measurements import Priors
from masat.renaming import shifted
from masat.stamps import joined_stamps
from masat.structure import NEW_SESSION, Structure

# The ids of a session are shifted by a multiple of a power of ten that is at least this one, and
# at least ten times the largest id.
_MIN_BLOCK = 10**6
# Information below this fraction of the largest is that of a direction that was not measured.
_LEAST_RATIO = 1e-9


def merge(
    graphs: Iterable[PoseGraph],
    between: PoseGraph | Sequence[ArrayLike] | None = None,
    *,
    offsets: Sequence[int] | None = None,
    common_frame: bool = False,
) -> PoseGraph:
    """Return one graph with the nodes and edges of several sessions, and links between them.

    Nodes are never identified with each other. The first graph keeps its ids, and those of each
    next one are shifted by a million, or by the power of ten that is at least ten times the largest
    id: node 17 of graph 2 becomes 2000017. So the ids tell in any file where a node comes from, and
    `masat.sessions` reads it from them. Where such ids do not fit in 64 bits, each graph begins a
    million ids after the one before.

    Parameters
    ----------
    graphs : iterable of PoseGraph
        The graphs, all in 2D or all in 3D. Each may have a frame of its own.
    between : (ends, measurements) or (ends, measurements, information) or PoseGraph, optional
        Links between the graphs. `ends` is (l, 4), rows of graph, id, graph, id, with the graphs
        counted from 0 and the ids they have there; or (l, 2), pairs of ids in the merged graph.
        Measurements and information are as `PoseGraph.with_edges` takes them. Of a PoseGraph its
        edges and their labels are taken, in the ids of the merged graph. Links come after the edges
        of the graphs, which keep their order.
    offsets : sequence of int, optional
        What to add to the ids of each graph, the first included; ``[0, 0]`` keeps those of two.
    common_frame : bool
        Whether the fixed nodes of all graphs are in one frame, and all remain fixed. By default,
        graphs with priors on positions are in the world's frame, and each other graph is in a frame
        of its own. Of the graphs that links connect, those with such priors keep their fixed nodes,
        or without any the first one with fixed nodes does; those of the others are fixed no longer.

    Returns
    -------
    PoseGraph
        It has poses if all graphs have, each in the frame of its own graph: solve before you
        compare poses of different graphs. Graphs that no link connects remain components of their
        own. Edges without a label get -1 among integers and the empty string among strings. It has
        stamps if all graphs have. Notes tell which graphs are not connected, and what became of
        poses, of fixed nodes and of stamps that are lost.

    Raises
    ------
    GraphError
        If an id occurs in two graphs after the shift, if 2D and 3D graphs, or stamps in seconds
        and in nanoseconds, are mixed, if a link names a graph or a node that is not there, or if
        the links fail the checks of `PoseGraph.with_edges`.

    Examples
    --------
    >>> import masat
    >>> walk = masat.PoseGraph.from_arrays([(0, 1), (1, 2)], [(1, 0, 0), (1, 0, 0)])
    >>> merged = masat.merge([walk, walk], ([(0, 2, 1, 0)], [(1, 0, 0)]))
    >>> merged.ids.tolist()
    [0, 1, 2, 1000000, 1000001, 1000002]
    >>> masat.sessions(merged).tolist()
    [0, 0, 0, 1, 1, 1]
    """
    if isinstance(graphs, PoseGraph):
        raise GraphError("give the graphs to merge as a list")
    parts = list(graphs)
    if not parts:
        raise GraphError("there is no graph to merge")
    for k, part in enumerate(parts):
        if not isinstance(part, PoseGraph):
            raise GraphError(f"graph {k} is no PoseGraph but of type {type(part).__name__}")
        if part.dimension != parts[0].dimension:
            raise GraphError(
                f"graph 0 is in {parts[0].dimension}D but graph {k} is in {part.dimension}D"
            )
    shifts = _offsets(parts) if offsets is None else _given_offsets(parts, offsets)
    ids = [shifted(part.ids, shift) for part, shift in zip(parts, shifts, strict=True)]
    nodes = np.concatenate(ids)
    order = np.argsort(nodes, kind="stable")
    _refuse_clash(nodes[order], order, [len(part.ids) for part in parts])
    moved = list(zip(parts, shifts, strict=True))
    structure = Structure(
        nodes[order],
        np.concatenate([shifted(part.edges, shift) for part, shift in moved]),
        np.empty(0, np.int64),
        parts[0].dof,
        np.concatenate([shifted(part.structure.roots, shift) for part, shift in moved]),
    )
    poses, notes = None, [note for part in parts for note in part.notes]
    have = [k for k, part in enumerate(parts) if part.poses is not None]
    if len(have) == len(parts):
        poses = np.concatenate([part.poses for part in parts if part.poses is not None])[order]
        if len(parts) > 1:
            notes.append(note_on_frames(parts))
    elif have:
        missing = next(k for k in range(len(parts)) if k not in have)
        notes.append(f"the merged graph has no poses, since graph {missing} has none")
    stamps = joined_stamps([part.stamps for part in parts])
    if stamps is None and any(part.stamps is not None for part in parts):
        missing = next(k for k, part in enumerate(parts) if part.stamps is None)
        notes.append(f"the merged graph has no stamps, since graph {missing} has none")
    merged = PoseGraph(
        ids=structure.ids,
        poses=poses,
        edges=structure.edges,
        measurements=np.concatenate([part.measurements for part in parts]),
        information=np.concatenate([part.information for part in parts]),
        fixed=structure.fixed,
        notes=tuple(dict.fromkeys(notes)),
        labels=joined_labels([(part.labels, len(part.edges)) for part in parts]),
        stamps=None if stamps is None else stamps[order],
        structure=structure,
    )
    merged = _with_measurements(merged, moved)
    session = np.repeat(np.arange(len(parts)), [len(part) for part in parts])[order]
    if between is not None:
        merged = _linked(merged, between, parts, shifts)
        merged = _with_note(merged, _unconnected(merged, session))
    # Links would refuse fixed nodes without poses that are fixed no longer in a moment.
    fixed = np.sort(np.concatenate([shifted(part.fixed, shift) for part, shift in moved]))
    if common_frame:
        return merged.with_fixed(fixed)
    in_world = np.array([bool(_measure_positions(part.priors).any()) for part in parts])
    return _with_own_frames(merged, fixed, session, in_world)


def _with_measurements(merged: PoseGraph, moved: list[tuple[PoseGraph, int]]) -> PoseGraph:
    """Return the merged graph with the priors and the landmarks of its parts, ids shifted."""
    priors = [
        part.priors.renamed(shifted(part.priors.ids, shift))
        for part, shift in moved
        if part.priors is not None
    ]
    seen = [
        replace(
            part.landmarks,
            ids=shifted(part.landmarks.ids, shift),
            observations=shifted(part.landmarks.observations, shift),
        )
        for part, shift in moved
        if part.landmarks is not None
    ]
    if seen:
        merged = merged.with_landmarks(seen)
    return merged.with_priors(priors) if priors else merged


def _linked(
    merged: PoseGraph,
    between: PoseGraph | Sequence[ArrayLike],
    parts: list[PoseGraph],
    shifts: list[int],
) -> PoseGraph:
    """Return the merged graph with its links."""
    if isinstance(between, PoseGraph):
        return merged.with_edges(
            between.edges, between.measurements, between.information, labels=between.labels, ids=[]
        )
    if not isinstance(between, tuple | list) or len(between) not in (2, 3):
        raise GraphError(
            "`between` must be (ends, measurements) or (ends, measurements, information), or a "
            "graph whose edges are the links"
        )
    ends = checks.integers("the ends of links", between[0])
    if ends.ndim == 2 and ends.shape[1] == 4:
        ends = _merged_ids(ends, parts, shifts)
    return merged.with_edges(ends, *between[1:], ids=[])


def _merged_ids(ends: Ids, parts: list[PoseGraph], shifts: list[int]) -> Ids:
    """Return the ids in the merged graph, (l, 2), of rows of graph, id, graph, id."""
    out = np.empty((len(ends), 2), np.int64)
    for column in (0, 1):
        graph, ids = ends[:, 2 * column], ends[:, 2 * column + 1]
        for k in np.flatnonzero((graph < 0) | (graph >= len(parts)))[:1]:
            raise GraphError(
                f"link {k} names graph {graph[k]}, but there are {len(parts)}, counted from 0"
            )
        for g, (part, shift) in enumerate(zip(parts, shifts, strict=True)):
            rows = np.flatnonzero(graph == g)
            for k in rows[~np.isin(ids[rows], part.ids)][:1]:
                raise GraphError(f"link {k} names node {ids[k]} of graph {g}, which has no such id")
            out[rows, column] = shifted(ids[rows], shift)
    return out


def _unconnected(merged: PoseGraph, session: Ids) -> str | None:
    """Say which sessions are not connected, given that of each node, (n,)."""
    count = int(session.max()) + 1
    joint = np.stack([session, count + merged.components], axis=1)
    group = _connected(count + int(merged.components.max()) + 1, joint)[:count]
    if group.max() == 0:
        return None
    maps = [", ".join(map(str, np.flatnonzero(group == g))) for g in np.unique(group)]
    return (
        f"no links connect these maps, each of which stays in a frame of its own: graphs "
        f"{'; '.join(maps)}"
    )


def _connected(count: int, pairs: Ids) -> Indices:
    """Return the connected component of each of so many things, by pairs of them."""
    structure = Structure(np.arange(count), pairs, np.empty(0, np.int64), 3)
    return structure.components


def _measure_positions(priors: Priors | None) -> Flags:
    """Return which priors, (p,), measure a position, or a horizontal one in 3D."""
    if priors is None:
        return np.empty(0, np.bool_)
    d = priors.dimension
    values = np.linalg.eigvalsh(priors.information[:, :d, :d])
    return np.asarray(values[:, -2] > _LEAST_RATIO * values[:, -1])


def _with_own_frames(merged: PoseGraph, fixed: Ids, session: Ids, in_world: Flags) -> PoseGraph:
    """Return the graph with, in each component, only those fixed nodes that share a frame.

    They are those of the sessions in the world's frame, given by a mask, where links or priors on
    positions tie the component to the world; in any other component they are those of its first
    session with any.
    """
    if len(fixed) == 0:
        return merged
    # Headings and altitudes do not tell where a frame lies.
    priors = merged.priors
    tied = merged.with_priors(None if priors is None else priors.rows(_measure_positions(priors)))
    where = merged.index(fixed)
    component, own = tied.components[where], session[where]
    first = np.full(int(tied.components.max()) + 1, len(in_world))
    np.minimum.at(first, component, own)
    stays: Flags = own == first[component]
    if tied.priors is not None:
        joint = tied.joint_structure
        to_world = joint.components[joint.index(fixed)] == joint.components[-1]
        stays = np.where(to_world, in_world[own], stays)
    merged = merged.with_fixed(fixed[stays])
    if stays.all():
        return merged
    others = ", ".join(map(str, np.unique(own[~stays])))
    note = (
        f"the fixed nodes of graphs {others} are fixed no longer, since links connect these to "
        "another graph with fixed nodes or position fixes, in a frame of its own; if all are in "
        "one frame, say so with common_frame=True (--common-frame)"
    )
    return _with_note(merged, note)


def _with_note(graph: PoseGraph, note: str | None) -> PoseGraph:
    return graph if note is None else replace(graph, notes=(*graph.notes, note))


def _offsets(parts: list[PoseGraph]) -> list[int]:
    """Return what to add to the ids of each graph."""
    ends = [_ends(part) for part in parts]
    gaps = [_gap(a, b) for a, b in pairwise(parts)]
    largest = max(max(-first, last) for first, last in ends)
    block = _MIN_BLOCK
    while block < max(10 * (largest + 1), 2 * max(gaps, default=0)):
        block *= 10
    if block * len(parts) < 2**63:
        return [k * block for k in range(len(parts))]
    out, last = [0], ends[0][1]
    for (first, end), gap in zip(ends[1:], gaps, strict=True):
        out.append(last + max(gap, _MIN_BLOCK) - first)
        last = end + out[-1]
    return out


def _gap(before: PoseGraph, after: PoseGraph) -> int:
    """Return a step of ids that tells `masat.sessions` where the second graph begins."""
    steps = [int(p.ids[k + 1]) - int(p.ids[k]) for p, k in ((before, -2), (after, 0)) if len(p) > 1]
    return NEW_SESSION * max(steps, default=1) + 1


def _ends(part: PoseGraph) -> tuple[int, int]:
    """Return the smallest and the largest id of a graph, its landmarks included."""
    every = [part.ids, part.point_ids] if len(part.point_ids) else [part.ids]
    return min(int(ids[0]) for ids in every), max(int(ids[-1]) for ids in every)


def _given_offsets(parts: list[PoseGraph], offsets: Sequence[int]) -> list[int]:
    given = checks.integers("offsets", offsets)
    if given.shape != (len(parts),):
        raise GraphError(
            f"offsets must be {len(parts)} integers, one a graph, got {given.tolist()}"
        )
    return [int(offset) for offset in given]


def _refuse_clash(nodes: Ids, order: Ids, sizes: list[int]) -> None:
    for k in np.flatnonzero(nodes[1:] == nodes[:-1])[:1]:
        a, b = np.searchsorted(np.cumsum(sizes), order[k : k + 2], side="right")
        raise GraphError(
            f"the graphs {a} and {b} both have a node {nodes[k]}: choose other offsets, or leave "
            "them out and the ids are shifted apart"
        )


def note_on_frames(parts: Sequence[PoseGraph]) -> str:
    """Say in which frames the poses of merged graphs are, before they are solved together."""
    note = f"the poses of {len(parts)} merged graphs are each in the frame of their own graph"
    fixed = [part for part in parts if len(part.fixed)]
    if len(fixed) > 1 and any(part.priors is None for part in fixed):
        note += "; so are the fixed nodes, which optimization does not move"
    return note
