"""What workers compute: functions of the file of a piece, of files of poses, and of messages.

A worker keeps the systems of its pieces at hand, since most tasks need what the task before has
computed. That is only a shortcut: a system that is not there, or is set up for something else, is
computed again from the same files and messages, to the same bits.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from masat import _core, lie
from masat.arrays import Floats
from masat.optimizers.equations import rounding_of
from masat.optimizers.losses import NamedLoss
from masat.parts.checkpoints import read_poses, write_poses
from masat.parts.chordal import Linear, LinearSystem
from masat.parts.elimination import (
    Linearization,
    Message,
    PieceNodes,
    PieceSystem,
    Solution,
    Step,
)
from masat.parts.pieces import read_piece

# A system that is set up again on another worker takes as long as its bytes on the network, and
# memory twice. Dask is to move a task only if there is much to gain.
_RELUCTANCE = 10


class PieceFile(NamedTuple):
    """Where the file of a piece is, what it must hold, and what its system takes.

    `memory` are the bytes of the system, `limit` those of all systems that a process may keep.
    `loss` is that of the cost, None for chi2, and `trusted` tells bit by bit to which edges it does
    not apply. `threads` is how many threads compute; a system that is held keeps its own number.
    """

    folder: str
    name: str
    graph_hash: str
    file_hash: str
    memory: int
    limit: int
    loss: NamedLoss | None
    trusted: bytes | None
    threads: int

    def __sizeof__(self) -> int:
        # By this Dask estimates what it costs to move a task away from the system that it needs.
        return _RELUCTANCE * self.memory


class Elimination(NamedTuple):
    """What an elimination depends on, besides the file of the piece.

    `diagonal` is that of H at the own nodes of a separator, None in a part.
    """

    poses: str
    damping: float
    floor: float
    diagonal: Floats | None


class _Workspace:
    """A system in memory, and what it is set up for."""

    def __init__(self, file: PieceFile) -> None:
        self.lock = threading.RLock()
        self.file = file
        path = Path(file.folder) / file.name
        piece = read_piece(path, file.graph_hash, file.file_hash)
        self.nodes = PieceNodes(piece)
        trusted = None
        if file.trusted is not None:
            bits = np.frombuffer(file.trusted, np.uint8)
            trusted = np.unpackbits(bits, count=len(piece.edges)).astype(np.bool_)
        self.system = PieceSystem(self.nodes, file.loss, trusted, file.threads)
        self.linearization: Linearization | None = None
        self.at = ""
        self.message: Message | None = None
        self.eliminated: tuple[str, float, float] | None = None
        self._linear: tuple[Linear, LinearSystem] | None = None

    def linear(self, task: Linear, messages: Sequence[Message]) -> LinearSystem:
        if self._linear is None or self._linear[0] != task:
            self._linear = None
            poses = None if task.poses is None else self.poses(task.poses)
            self._linear = task, LinearSystem(self.nodes, poses, messages)
        return self._linear[1]

    def poses(self, name: str) -> Floats:
        return read_poses(self.file.folder, name, self.file.name, self.nodes.piece)

    def linearize(self, poses: str, known: Floats | None = None) -> Linearization:
        if self.linearization is None or self.at != poses:
            at = self.poses(poses) if known is None else known
            # An interruption must not leave what was known of other poses.
            self.linearization = self.eliminated = self._linear = None
            self.linearization, self.at = self.system.linearize(at), poses
        return self.linearization

    def eliminate(self, task: Elimination, messages: Sequence[Message]) -> Message:
        wanted = task.poses, task.damping, task.floor
        if self.message is None or self.eliminated != wanted:
            self.eliminated = None
            self.linearize(task.poses)
            self.message = self.system.eliminate(task.damping, task.floor, task.diagonal, messages)
            self.eliminated = wanted
        return self.message


class _Workspaces:
    """The systems of a process, the one used last at the end."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._held: OrderedDict[tuple[object, ...], _Workspace] = OrderedDict()

    def of(self, file: PieceFile) -> _Workspace:
        key = file.folder, file.name, file.file_hash, file.loss, file.trusted
        with self._lock:
            found = self._held.get(key)
            if found is not None:
                self._held.move_to_end(key)
                return found
            # The one that is asked for is held in any case.
            while self._held and self._memory() + file.memory > file.limit:
                self._held.popitem(last=False)
        made = _Workspace(file)
        with self._lock:
            return self._held.setdefault(key, made)

    def release(self, folder: str) -> None:
        with self._lock:
            for key in [key for key in self._held if key[0] == folder]:
                del self._held[key]

    def _memory(self) -> int:
        return sum(one.file.memory for one in self._held.values())


_WORKSPACES = _Workspaces()


def hold(file: PieceFile) -> PieceFile:
    """Set up the system of a piece, and return what other tasks find it by."""
    _WORKSPACES.of(file)
    return file


def release(folder: str) -> None:
    """Free the systems of the pieces of a folder, and the workspace of this thread."""
    _WORKSPACES.release(folder)
    _core.free_workspace()


def linearize(file: PieceFile, poses: str) -> Linearization:
    """Return what the other pieces have to know of a piece at some poses."""
    workspace = _WORKSPACES.of(file)
    with workspace.lock:
        return workspace.linearize(poses)


def eliminate(file: PieceFile, task: Elimination, messages: Sequence[Message]) -> Message:
    """Eliminate the nodes of a piece; `messages` are those of its children."""
    workspace = _WORKSPACES.of(file)
    with workspace.lock:
        return workspace.eliminate(task, messages)


def substitute(
    file: PieceFile,
    task: Elimination,
    messages: Sequence[Message],
    above: Solution | None,
    target: str,
) -> Solution:
    """Solve for the step of a piece, and write the poses after it as those of the name `target`.

    What every optimizer asks next, the linearization there, is found at once. The values of the
    step are returned only if pieces below need them.
    """
    workspace = _WORKSPACES.of(file)
    with workspace.lock:
        message = workspace.eliminate(task, messages)
        failed = message.failed if above is None else above.failed
        if failed is not None:
            nothing = np.empty(0)
            return Solution(
                Step(nothing, 0.0, 0.0), Linearization(0.0, 0.0, 0.0, nothing, nothing), failed
            )
        step = workspace.system.substitute(None if above is None else above.step.values)
        poses = workspace.poses(task.poses)
        moved = lie.retract(poses, step.values.reshape(len(poses), -1)) if len(poses) else poses
        write_poses(file.folder, target, file.name, moved)
        if workspace.nodes.piece.children == 0:
            step = step._replace(values=np.empty(0))
        return Solution(step, workspace.linearize(target, moved))


def eliminate_linear(file: PieceFile, task: Linear, messages: Sequence[Message]) -> Message:
    """Eliminate the nodes of a piece from a system of the chordal guess; see `eliminate`."""
    workspace = _WORKSPACES.of(file)
    with workspace.lock:
        return workspace.linear(task, messages).message


def solve_linear(
    file: PieceFile, task: Linear, messages: Sequence[Message], above: Floats | None, target: str
) -> Floats:
    """Solve a system of the chordal guess, and write the poses that follow as `target`.

    The unknowns are returned only if pieces below need them.
    """
    workspace = _WORKSPACES.of(file)
    with workspace.lock:
        unknowns, poses = workspace.linear(task, messages).solve(above)
        write_poses(file.folder, target, file.name, poses)
        return unknowns if workspace.nodes.piece.children else np.empty(0)


def chi2(file: PieceFile, poses: str) -> float:
    """Return the chi2 of the edges of a piece at some poses, whatever the loss."""
    workspace = _WORKSPACES.of(file)
    with workspace.lock:
        system = workspace.system
        return system.chi2(workspace.poses(poses))


def rounding(file: PieceFile, poses: str) -> float:
    """Return the chi2 that the rounding of coordinates alone makes in the edges of a piece."""
    workspace = _WORKSPACES.of(file)
    with workspace.lock:
        piece = workspace.system.piece
        at = workspace.poses(poses)
        return rounding_of(np.concatenate([at, piece.fixed_poses]), piece.edges, piece.information)
