"""A piece of a graph, and its file.

A piece is a part or a separator: what one worker eliminates at a time.
"""

from __future__ import annotations

import hashlib
import io
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from masat.arrays import Flags, Floats, Ids, Indices, LockedArrays
from masat.errors import PartitionError
from masat.files import DAMAGED, write_atomically

_OPTIONAL = ("offsets", "range_bearing")


@dataclass(frozen=True, eq=False, repr=False)
class Piece(LockedArrays):
    """Nodes that are eliminated together, the edges of which no other piece has, and their ends.

    Attributes
    ----------
    ids : ndarray of int64, (k,)
        Ids of its own nodes, then of its boundary, then of the fixed nodes that it meets.
    sizes : ndarray of int64, (3,)
        How many there are of each.
    order : ndarray of int32
        The elimination order of its own nodes.
    separators : ndarray of int64
        Of a separator, the numbers of its own nodes, then those of the boundary, among the nodes
        of all separators; of a part, of the boundary.
    in_parent : ndarray of int32
        Index of each boundary node among the own and boundary nodes of the parent.
    child_nodes : ndarray of int32
        The same of each child, one after the other: indices among the nodes here.
    child_start : ndarray of int64
        Where those of each child begin, and the end.
    edges : ndarray of int32, (m, 2)
        Indices in `ids`.
    rows : ndarray of int64, (m,)
        Index of each edge in the graph.
    measurements, information : ndarray, (m, 3) or (m, 7), and (m, 3, 3) or (m, 6, 6)
        As of a graph.
    fixed_poses : ndarray, (f, 3) or (f, 7)
        Poses of the fixed nodes.
    offsets : ndarray, (m, 3) or (m, 7), or None
        Poses of sensors, as of `AssembledGraph`.
    range_bearing : ndarray of bool, (m,), or None
        Which edges measure range and bearing, as of `AssembledGraph`.
    """

    ids: Ids
    sizes: Ids
    order: Indices
    separators: Ids
    in_parent: Indices
    child_nodes: Indices
    child_start: Ids
    edges: Indices
    rows: Ids
    measurements: Floats
    information: Floats
    fixed_poses: Floats
    offsets: Floats | None = None
    range_bearing: Flags | None = None

    @property
    def own(self) -> int:
        """Number of nodes that are eliminated here."""
        return int(self.sizes[0])

    @property
    def boundary(self) -> int:
        """Number of nodes that are eliminated further up."""
        return int(self.sizes[1])

    def child(self, k: int) -> Indices:
        """Return the indices, among the nodes here, of the boundary of a child."""
        nodes: Indices = self.child_nodes[self.child_start[k] : self.child_start[k + 1]]
        return nodes

    @property
    def children(self) -> int:
        """Number of pieces below it."""
        return len(self.child_start) - 1

    @property
    def dimension(self) -> int:
        """2 or 3."""
        return 2 if self.measurements.shape[1] == 3 else 3


def write_piece(path: Path, piece: Piece, graph_hash: str) -> str:
    """Write a piece; return the hash of the file."""
    buffer = io.BytesIO()
    every = {field.name: getattr(piece, field.name) for field in fields(piece)}
    arrays = {name: array for name, array in every.items() if array is not None}
    np.savez(buffer, graph=np.array(graph_hash), **arrays)
    data = buffer.getvalue()
    write_atomically(path, data)
    return hash_of(data)


def read_piece(path: Path, graph_hash: str, file_hash: str) -> Piece:
    """Read a piece.

    Raises
    ------
    PartitionError
        If the file is missing, damaged, or of another graph.
    """
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise missing(path) from None
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
            if str(arrays["graph"]) != graph_hash:
                raise of_another_graph(path)
            if hash_of(data) != file_hash:
                raise damaged(path)
            names = [field.name for field in fields(Piece)]
            given = [name for name in names if name not in _OPTIONAL or name in arrays]
            return Piece(**{name: arrays[name] for name in given})
    except (*DAMAGED, OSError) as error:
        if isinstance(error, PartitionError):
            raise
        raise damaged(path) from None


def read_separators(path: Path, graph_hash: str) -> Ids:
    """Read `Piece.separators` alone."""
    return _read_indices(path, graph_hash, "separators")


def read_rows(path: Path, graph_hash: str) -> Ids:
    """Read `Piece.rows` alone."""
    return _read_indices(path, graph_hash, "rows")


def _read_indices(path: Path, graph_hash: str, name: str) -> Ids:
    try:
        with np.load(path, allow_pickle=False) as arrays:
            if str(arrays["graph"]) != graph_hash:
                raise of_another_graph(path)
            indices: Ids = arrays[name]
            return indices
    except FileNotFoundError:
        raise missing(path) from None
    except (*DAMAGED, OSError) as error:
        if isinstance(error, PartitionError):
            raise
        raise damaged(path) from None


def missing(path: Path) -> PartitionError:
    """Return the error of a file that is not there."""
    return PartitionError(f"{path}: is missing; restore it, or partition the graph again")


def of_another_graph(path: Path) -> PartitionError:
    """Return the error of a file that belongs to another partition."""
    return PartitionError(f"{path}: is of another graph than the index; partition the graph again")


def damaged(path: Path) -> PartitionError:
    """Return the error of a file that is not what was written."""
    return PartitionError(f"{path}: is damaged; restore it, or partition the graph again")


def hash_of(*data: Any) -> str:
    """Return a hash of buffers."""
    digest = hashlib.blake2b(digest_size=16)
    for buffer in data:
        digest.update(buffer)
    return digest.hexdigest()
