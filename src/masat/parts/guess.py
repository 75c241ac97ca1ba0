"""Initial guesses of a graph in pieces.

MASAT and the spanning tree go from piece to piece, from the nodes that are not optimized: in each,
the nodes are placed from those of its boundary that other pieces have placed. Pieces that can go
on at the same time do. The chordal guess eliminates its two systems as the optimizers do theirs.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from masat import _core, lie
from masat.arrays import Flags, Floats, Ids
from masat.errors import PartitionError
from masat.linear import undetermined_node
from masat.parts import tasks
from masat.parts.checkpoints import read_poses, write_poses
from masat.parts.chordal import Linear
from masat.parts.elimination import Message
from masat.parts.engines import Engine
from masat.parts.index import Index
from masat.parts.pieces import read_piece
from masat.parts.sweeps import down, up
from masat.parts.tasks import PieceFile


class _Reached(NamedTuple):
    """The nodes of a piece that are placed, of those in `Piece.separators`."""

    placed: Flags
    poses: Floats
    complete: bool


def _place_by_masat(
    topology: _core.Topology, roots: Any, measurements: Floats, poses: Floats
) -> Floats:
    return _core.place_by_masat(topology, roots, measurements, poses)


def _place_along_tree(
    topology: _core.Topology, roots: Any, measurements: Floats, poses: Floats
) -> Floats:
    return _core.place_along_tree(topology, roots, np.empty(0, np.bool_), measurements, poses)[0]


_WALKS: dict[str, Callable[[_core.Topology, Any, Floats, Floats], Floats]] = {
    "masat": _place_by_masat,
    "spanning_tree": _place_along_tree,
}

GUESSES = ("chordal", *_WALKS)


def place(
    file: PieceFile, method: str, target: str, placed: Flags, poses: Floats, begun: bool
) -> _Reached:
    """Place the nodes of a piece that can be reached, and write their poses.

    Parameters
    ----------
    file : PieceFile
        The piece.
    method : str
        One of `_WALKS`.
    target : str
        Name of the poses.
    placed : ndarray of bool
        Which nodes in `Piece.separators` are placed.
    poses : ndarray
        Their poses.
    begun : bool
        Whether the piece has been visited before.
    """
    piece = read_piece(Path(file.folder) / file.name, file.graph_hash, file.file_hash)
    free = piece.own + piece.boundary
    at = np.tile(lie.identity(piece.dimension), (len(piece.ids), 1))
    known = np.zeros(len(piece.ids), np.bool_)
    at[free:], known[free:] = piece.fixed_poses, True
    first = free - len(piece.separators)  # the own nodes of a part are not among the separators
    if begun:
        before = read_poses(file.folder, target, file.name, piece)
        at[:first] = before[:first]
        known[:first] = ~np.isnan(before[:first, 0])
    at[first:free][placed], known[first:free][placed] = poses[placed], True
    topology = _core.Topology(len(piece.ids), np.ascontiguousarray(piece.edges))
    labels = topology.components()
    reached = np.isin(labels, labels[known])
    if not known.all() and known.any():
        roots = np.flatnonzero(known).astype(np.int32)
        at = _WALKS[method](topology, roots, piece.measurements, at)
    at[~reached] = np.nan
    write_poses(file.folder, target, file.name, at[:free])
    return _Reached(reached[first:free], at[first:free], bool(reached.all()))


def finish(file: PieceFile, target: str, poses: Floats) -> None:
    """Write the poses of separators as they are in the end."""
    piece = read_piece(Path(file.folder) / file.name, file.graph_hash, file.file_hash)
    at = read_poses(file.folder, target, file.name, piece).copy()
    at[len(at) - len(piece.separators) :] = poses
    write_poses(file.folder, target, file.name, at)


def initial_guess(
    index: Index,
    separators: list[Ids],
    engine: Engine,
    method: str,
    target: str,
) -> None:
    """Write the poses of one of the `GUESSES`."""
    if method == "chordal":
        _solve_chordal(index, engine, target)
    else:
        _walk(index, separators, engine, method, target)


def _solve_chordal(index: Index, engine: Engine, target: str) -> None:
    turned = f"{target}-turned"
    for system, poses in ((Linear(None), turned), (Linear(turned), target)):
        jobs = [system] * len(index.pieces)
        messages = up(index, engine, tasks.eliminate_linear, jobs)
        roots = [m for m, entry in zip(messages, index.pieces, strict=True) if entry.parent < 0]
        found: list[Message] = engine.gather(roots)
        failed = [root.failed for root in found if root.failed is not None]
        if failed:
            raise undetermined_node(min(failed), system.unknown)
        engine.gather(down(index, engine, tasks.solve_linear, jobs, messages, poses))


def _walk(index: Index, separators: list[Ids], engine: Engine, method: str, target: str) -> None:
    files = engine.files()
    placed = np.zeros(index.separators, np.bool_)
    poses = np.tile(lie.identity(index.dimension), (index.separators, 1))
    visited = np.zeros(len(files), np.bool_)
    complete = visited.copy()
    turn = list(range(len(files)))
    while turn:
        jobs = engine.map(
            place,
            [files[k] for k in turn],
            [method] * len(turn),
            [target] * len(turn),
            [placed[separators[k]] for k in turn],
            [poses[separators[k]] for k in turn],
            visited[turn].tolist(),
        )
        new = np.zeros(index.separators, np.bool_)
        for k, found in zip(turn, engine.gather(jobs), strict=True):
            visited[k], complete[k] = True, found.complete
            own = separators[k]
            first = found.placed & ~placed[own] & ~new[own]
            poses[own[first]] = found.poses[first]
            new[own[first]] = True
        placed |= new
        turn = [k for k in np.flatnonzero(~complete).tolist() if new[separators[k]].any()]
    if not complete.all() or not placed.all():
        raise PartitionError(
            "the initial guess did not reach all nodes; the partition is damaged: partition the "
            "graph again"
        )
    ends = [poses[own] for own in separators]
    engine.gather(engine.map(finish, files, [target] * len(files), ends))
