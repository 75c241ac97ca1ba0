"""A graph is cut into pieces, each of which is written to a file of its own."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from masat import lie
from masat.arrays import AnyArray, Floats, Ids, Indices
from masat.assembly import Assembly, assemble, needs_assembly
from masat.determinacy import with_undetermined_kept
from masat.errors import PartitionError
from masat.graph import PoseGraph
from masat.groups import Groups
from masat.initializers import initialize
from masat.parts.checkpoints import GIVEN, write_poses
from masat.parts.dissection import Dissection, checked_labels, dissect, dissect_evenly, given_labels
from masat.parts.elimination import PieceNodes
from masat.parts.index import Entry, Index
from masat.parts.ordering import ordered
from masat.parts.pieces import Piece, hash_of, write_piece


def write_partition(
    graph: PoseGraph,
    folder: str | os.PathLike[str],
    parts: int | None = None,
    labels: ArrayLike | None = None,
) -> Index:
    """Cut a graph into pieces and write them; parameters as of `masat.partition`."""
    folder = Path(folder)
    if (parts is None) == (labels is None):
        raise PartitionError("give either the number of parts or the part of each node")
    source, world, notes = graph, None, list[str]()
    checked = None if labels is None else checked_labels(source, labels)
    if needs_assembly(source):
        assembly, notes = _assembled(source)
        graph, world = assembly.graph, int(assembly.graph.ids[-1])
        checked = None if checked is None else _labels_of_nodes(assembly, checked)
    if len(graph.structure.free) == 0:
        raise PartitionError("the graph has no node that is optimized")
    folder.mkdir(parents=True, exist_ok=True)
    if any(folder.iterdir()):
        raise PartitionError(f"{folder}: is not empty; choose another folder")
    if checked is not None:
        tree = dissect(graph, given_labels(graph, checked))
    elif parts is not None:
        tree = dissect_evenly(graph, parts)
    cut = _Cut(graph, tree)
    graph_hash = _hash(graph)
    entries = [cut.write(k, folder, graph_hash) for k in range(len(tree.parent))]
    index = Index(
        graph=graph_hash,
        dimension=graph.dimension,
        nodes=len(source),
        edges=len(source.edges),
        priors=0 if source.priors is None else len(source.priors),
        observations=0 if source.landmarks is None else len(source.landmarks.observations),
        landmarks=0 if source.landmarks is None else len(source.landmarks),
        world=world,
        notes=notes,
        parts=tree.parts,
        separators=len(cut.separators),
        with_poses=graph.poses is not None,
        pieces=entries,
    )
    index.save(folder)
    return index


def _labels_of_nodes(assembly: Assembly, labels: Ids) -> Ids:
    """Return the parts of all nodes: a landmark is in that of the pose that saw it first."""
    out = np.zeros(len(assembly.graph.ids), np.int64)
    out[assembly.poses_at] = labels
    pose, point = assembly.graph.edge_indices[assembly.observation_rows].T
    seen, first = np.unique(point, return_index=True)
    out[seen] = out[pose[first]]
    return out


def _assembled(source: PoseGraph) -> tuple[Assembly, list[str]]:
    """Return the graph of edges alone in the place of one with other measurements, and notes."""
    unplaced = source.landmarks is not None and source.points is None
    if source.poses is None or unplaced:
        source = initialize(source, "masat")
    return with_undetermined_kept(assemble(source))


class _Cut:
    """The pieces of a graph."""

    def __init__(self, graph: PoseGraph, tree: Dissection) -> None:
        self._graph, self._tree = graph, tree
        count, piece = len(tree.parent), tree.piece
        ends = np.where(piece[graph.edge_indices] < 0, count, piece[graph.edge_indices])
        owner = ends.min(axis=1) % count if len(ends) else np.empty(0, np.int32)
        self._edges = Groups(owner, count)
        # Nodes that are not optimized are a group of their own.
        self._nodes = Groups(np.where(piece < 0, count, piece), count + 1)
        by_piece = self._nodes.of_all(np.arange(tree.parts, count))
        self.separators: Ids = by_piece
        self._number = np.full(len(graph), -1, np.int64)
        self._number[by_piece] = np.arange(len(by_piece))
        self._children: list[list[int]] = [[] for _ in range(count)]
        for k, parent in enumerate(tree.parent):
            if parent >= 0:
                self._children[parent].append(k)
        self._boundaries: list[Ids] = []
        for k in range(count):
            met = [graph.edge_indices[self._edges.of(k)].ravel().astype(np.int64)]
            met += [self._boundaries[c] for c in self._children[k]]
            found = np.unique(np.concatenate(met))
            found = found[piece[found] > k]
            self._boundaries.append(found[np.argsort(self._number[found])])
        self._local = np.full(len(graph), -1, np.int32)

    def write(self, k: int, folder: Path, graph_hash: str) -> Entry:
        """Write a piece, and its poses if the graph has any; return what the index tells of it."""
        piece, nodes = self._piece(k)
        graph, dof = self._graph, self._graph.dof
        kind, number = ("part", k) if k < self._tree.parts else ("separator", k - self._tree.parts)
        file = folder / f"{kind}-{number}.npz"
        file_hash = write_piece(file, piece, graph_hash)
        if graph.poses is not None:
            free = np.concatenate([self._nodes.of(k), self._boundaries[k]])
            write_poses(str(folder), GIVEN, file.name, graph.poses[free])
        blocks = len(piece.ids) + len(piece.edges) + len(piece.child_nodes)
        measured = piece.measurements.nbytes + piece.information.nbytes + piece.edges.nbytes
        at_boundary = piece.boundary * dof
        return Entry(
            file=file.name,
            hash=file_hash,
            size=file.stat().st_size,
            parent=self._tree.parent[k],
            children=self._children[k],
            own=piece.own,
            boundary=piece.boundary,
            edges=len(piece.edges),
            operations=nodes.elimination.operations(dof),
            memory=nodes.elimination.factor_bytes(dof) + 8 * blocks * dof * dof + measured,
            # The values at the boundary. Contribution blocks on their way to it lie on two stacks,
            # each of which comes to hold a block of about its size.
            workspace=3 * 8 * at_boundary**2,
            message=8 * (at_boundary * (at_boundary + 1) // 2 + at_boundary),
        )

    def _piece(self, k: int) -> tuple[Piece, PieceNodes]:
        graph = self._graph
        own, boundary, rows = self._nodes.of(k), self._boundaries[k], self._edges.of(k)
        ends = graph.edge_indices[rows]
        fixed = np.unique(ends[self._tree.piece[ends] < 0]).astype(np.int64)
        nodes = np.concatenate([own, boundary, fixed])
        self._local[nodes] = np.arange(len(nodes))
        edges = self._local[ends].reshape(-1, 2)
        of_children = [self._within(k, self._boundaries[c]) for c in self._children[k]]
        parent = self._tree.parent[k]
        in_parent = self._within(parent, boundary) if parent >= 0 else np.empty(0, np.int32)
        separator = k >= self._tree.parts
        numbered = nodes[: len(own) + len(boundary)] if separator else boundary
        piece = Piece(
            ids=graph.ids[nodes],
            sizes=np.array([len(own), len(boundary), len(fixed)]),
            order=np.arange(len(own), dtype=np.int32),
            separators=self._number[numbered],
            in_parent=in_parent,
            child_nodes=np.concatenate([np.empty(0, np.int32), *of_children]),
            child_start=np.concatenate([[0], np.cumsum([len(c) for c in of_children])]).astype(
                np.int64
            ),
            edges=edges,
            rows=rows,
            measurements=np.ascontiguousarray(graph.measurements[rows]),
            information=np.ascontiguousarray(graph.information[rows]),
            fixed_poses=self._fixed_poses(fixed),
            offsets=_rows(graph.sensor_offsets, rows),
            range_bearing=_rows(graph.range_bearing_edges, rows),
        )
        if separator:
            return piece, PieceNodes(piece)
        return ordered(piece, graph.dof)

    def _within(self, separator: int, nodes: Ids) -> Indices:
        """Return the indices of nodes among the own and boundary nodes of a separator."""
        every = np.concatenate([self._nodes.of(separator), self._boundaries[separator]])
        # Separators are numbered from the parts up, and their nodes one after the other.
        return np.searchsorted(self._number[every], self._number[nodes]).astype(np.int32)

    def _fixed_poses(self, nodes: Ids) -> Floats:
        graph = self._graph
        if graph.poses is None:
            return np.tile(lie.identity(graph.dimension), (len(nodes), 1))
        return np.ascontiguousarray(graph.poses[nodes])


def _rows(array: Any | None, rows: Ids) -> Any | None:
    return None if array is None else np.ascontiguousarray(array[rows])


def _hash(graph: PoseGraph) -> str:
    poses = np.empty(0) if graph.poses is None else graph.poses
    arrays: list[AnyArray] = [
        graph.ids,
        graph.edges,
        graph.measurements,
        graph.information,
        graph.fixed,
        poses,
    ]
    arrays += [a for a in (graph.sensor_offsets, graph.range_bearing_edges) if a is not None]
    return hash_of(*(np.ascontiguousarray(a).data.cast("B") for a in arrays if a.size))
