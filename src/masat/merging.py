"""Merging graphs, for example the sessions of one robot, into one graph."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from masat import _checks as checks
from masat.arrays import Ids
from masat.editing import joined_labels, shifted
from masat.errors import GraphError
from masat.graph import PoseGraph
from masat.measurements import landmarks
from masat.stamps import joined_stamps
from masat.structure import Structure


def merge(
    graphs: Iterable[PoseGraph],
    between: Sequence[ArrayLike] | None = None,
    *,
    offsets: Sequence[int] | None = None,
) -> PoseGraph:
    """Return one graph with the nodes and edges of several, and edges between them.

    Nodes are never identified with each other. The first graph keeps its ids. Those of each next
    graph are shifted so that its smallest id is one above the largest id before it. The shift of
    the second graph is ``graphs[0].ids[-1] + 1 - graphs[1].ids[0]``.

    Parameters
    ----------
    graphs : iterable of PoseGraph
        The graphs, all in 2D or all in 3D.
    between : (edges, measurements) or (edges, measurements, information), optional
        Edges between the graphs, in the ids of the merged graph, as `PoseGraph.with_edges` takes
        them. They come after the edges of the graphs, which keep their order.
    offsets : sequence of int, optional
        What to add to the ids of each graph, the first included; ``[0, 0]`` keeps those of two.

    Returns
    -------
    PoseGraph
        It has poses if all graphs have, each in the frame of its own graph: optimize before you
        compare poses of different graphs. All fixed nodes remain fixed. Edges without a label get
        -1 among integers and the empty string among strings. It has stamps if all graphs have.
        Notes tell what became of the poses, and of stamps that are lost.

    Raises
    ------
    GraphError
        If an id occurs in two graphs after the shift, if 2D and 3D graphs, or stamps in seconds
        and in nanoseconds, are mixed, or if the edges between them fail the checks of
        `PoseGraph.with_edges`.
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
        np.sort(np.concatenate([shifted(part.fixed, shift) for part, shift in moved])),
        parts[0].dof,
        np.concatenate([shifted(part.structure.roots, shift) for part, shift in moved]),
    )
    poses, notes = None, [note for part in parts for note in part.notes]
    have = [k for k, part in enumerate(parts) if part.poses is not None]
    if len(have) == len(parts):
        poses = np.concatenate([part.poses for part in parts if part.poses is not None])[order]
        if len(parts) > 1:
            notes.append(_frames(parts))
    elif have:
        missing = next(k for k in range(len(parts)) if k not in have)
        notes.append(f"the merged graph has no poses, since graph {missing} has none")
    structure.check_fixed(poses)
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
    if between is None:
        return merged
    if not isinstance(between, tuple | list) or len(between) not in (2, 3):
        raise GraphError(
            "`between` must be (edges, measurements) or (edges, measurements, information)"
        )
    return merged.with_edges(*between, ids=[])


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
        known = [part.positions for part in seen if part.positions is not None]
        all_landmarks = landmarks(
            np.concatenate([part.observations for part in seen]),
            np.concatenate([part.measurements for part in seen]),
            np.concatenate([part.information for part in seen]),
            ids=np.concatenate([part.ids for part in seen]),
            positions=np.concatenate(known) if len(known) == len(seen) else None,
        )
        merged = merged.with_landmarks(all_landmarks)
    return merged.with_priors(priors) if priors else merged


def _offsets(parts: list[PoseGraph]) -> list[int]:
    out, last = [0], _ends(parts[0])[1]
    for part in parts[1:]:
        first, end = _ends(part)
        out.append(last + 1 - first)
        last = end + out[-1]
    return out


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


def _frames(parts: list[PoseGraph]) -> str:
    note = f"the poses of {len(parts)} merged graphs are each in the frame of their own graph"
    if sum(len(part.fixed) > 0 for part in parts) > 1:
        note += "; so are the fixed nodes, which optimization does not move"
    return note
