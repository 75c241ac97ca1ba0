"""Poses on disk, and how far a solve is.

Poses have a name, and a file for each piece in a folder of that name.
"""

from __future__ import annotations

import io
import json
import shutil
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from masat.arrays import Floats
from masat.errors import PartitionError
from masat.files import DAMAGED, write_atomically
from masat.optimizers.losses import NamedLoss
from masat.optimizers.termination import Iteration
from masat.parts.pieces import Piece, missing

GIVEN = "given"
_STATE, _FILE = "state", "solve.json"


@dataclass(frozen=True)
class Checkpoint:
    """How far a solve is.

    Attributes
    ----------
    graph : str
        Hash of the graph.
    method : str
        The optimizer.
    init : str
        The initial guess.
    poses : str
        Name of the poses of the lowest cost.
    initial_chi2 : float
        chi2 at the initial guess, or where a solve with another loss had ended.
    chi2 : float
        chi2 at these poses; with a loss, the robust cost.
    history : list of Iteration
        All iterations, of interrupted solves too.
    reason : str or None
        Why the solve stopped; None while it goes on and after it was interrupted.
    loss : tuple of str and float, or None
        Name and scale of the loss that is minimized; None if chi2 is.
    trusted : str or None
        Hash of the edges to which it does not apply; None if it applies to all.
    """

    graph: str
    method: str
    init: str
    poses: str
    initial_chi2: float
    chi2: float
    history: list[Iteration]
    reason: str | None
    loss: NamedLoss | None = None
    trusted: str | None = None

    def save(self, folder: Path) -> None:
        """Write it to the folder of a partition."""
        saved = asdict(self) | {"history": [list(iteration) for iteration in self.history]}
        (folder / _STATE).mkdir(exist_ok=True)
        write_atomically(folder / _STATE / _FILE, json.dumps(saved).encode())


def read_checkpoint(folder: Path, graph_hash: str) -> Checkpoint | None:
    """Return how far a solve is, or None if none was begun.

    Raises
    ------
    PartitionError
        If the file is damaged or of another graph.
    """
    path = folder / _STATE / _FILE
    try:
        saved = json.loads(path.read_bytes())
        saved["history"] = [Iteration(*row) for row in saved["history"]]
        if saved.get("loss") is not None:
            name, scale = saved["loss"]
            saved["loss"] = (str(name), float(scale))
        found = Checkpoint(**saved)
    except FileNotFoundError:
        return None
    except (ValueError, TypeError, KeyError):
        raise PartitionError(
            f"{path}: is damaged; delete {path.parent} to begin the solve again"
        ) from None
    if found.graph != graph_hash:
        raise PartitionError(
            f"{path}: is of a solve of another graph; delete {path.parent} to begin again"
        )
    return found


def _path(folder: str, poses: str, piece: str) -> Path:
    return Path(folder) / _STATE / poses / f"{Path(piece).stem}.npy"


def write_poses(folder: str, poses: str, piece: str, values: Floats) -> None:
    """Write the poses of the own nodes and of the boundary of a piece."""
    path = _path(folder, poses, piece)
    path.parent.mkdir(parents=True, exist_ok=True)
    buffer = io.BytesIO()
    np.save(buffer, values)
    write_atomically(path, buffer.getvalue())


def read_poses(folder: str, poses: str, name: str, piece: Piece) -> Floats:
    """Read the poses of the own nodes and of the boundary of a piece.

    Raises
    ------
    PartitionError
        If the file is missing or damaged.
    """
    path = _path(folder, poses, name)
    try:
        values: Floats = np.load(path, allow_pickle=False)
    except FileNotFoundError:
        raise missing(path) from None
    except DAMAGED:
        raise PartitionError(
            f"{path}: is damaged; delete {path.parent.parent} to begin the solve again"
        ) from None
    if values.shape != (piece.own + piece.boundary, piece.measurements.shape[1]):
        raise PartitionError(
            f"{path}: does not fit its piece; delete {path.parent.parent} to begin the solve again"
        )
    return values


def forget_poses(folder: Path, kept: set[str]) -> None:
    """Delete all poses but those with the given names."""
    for old in (folder / _STATE).iterdir():
        if old.is_dir() and old.name not in kept:
            shutil.rmtree(old, ignore_errors=True)
