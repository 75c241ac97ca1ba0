"""The index of a partition: its pieces, their tree, and what each of them costs."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from masat.errors import PartitionError
from masat.files import write_atomically
from masat.parts.pieces import missing

_FILE = "index.json"
_VERSION = 2


@dataclass(frozen=True)
class Entry:
    """A piece in the index.

    Attributes
    ----------
    file : str
        Name of its file.
    hash : str
        Hash of the file.
    size : int
        Bytes of the file.
    parent : int
        Index of the separator above it, or -1.
    children : list of int
        Indices of the pieces below it.
    own, boundary, edges : int
        Number of nodes eliminated in it, of nodes of separators above that it touches, of edges.
    operations : float
        Floating-point operations of a factorization.
    memory : int
        Bytes of its system, its factor and its measurements in memory.
    workspace : int
        Bytes of memory that a factorization takes besides, about. The pieces that a thread
        factorizes share it.
    message : int
        Bytes of the contribution block that it sends to its parent.
    """

    file: str
    hash: str
    size: int
    parent: int
    children: list[int]
    own: int
    boundary: int
    edges: int
    operations: float
    memory: int
    workspace: int
    message: int


@dataclass(frozen=True)
class Index:
    """What a partition consists of.

    Attributes
    ----------
    graph : str
        Hash of the graph.
    dimension, nodes, edges : int
        Those of the graph.
    priors, observations, landmarks : int
        How many it has of these.
    world : int or None
        The id of the node that stands for the world, from which priors are edges; None without
        one. Rows of edges in the pieces are those of the graph, its priors, its observations, one
        for the rotation of each landmark, and those that keep what is not determined.
    notes : list of str
        What is not determined.
    parts : int
        Number of parts; the first pieces are the parts, the others separators.
    separators : int
        Number of nodes in separators.
    with_poses : bool
        Whether the graph had poses.
    pieces : list of Entry
        Children before parents.
    """

    graph: str
    dimension: int
    nodes: int
    edges: int
    priors: int
    observations: int
    landmarks: int
    world: int | None
    notes: list[str]
    parts: int
    separators: int
    with_poses: bool
    pieces: list[Entry]

    def save(self, folder: Path) -> None:
        """Write the index, which makes a partition complete."""
        text = json.dumps({"version": _VERSION, **asdict(self)}, indent=1)
        write_atomically(folder / _FILE, text.encode())


def read_index(folder: Path) -> Index:
    """Read the index of a partition, and look whether its files are there.

    Raises
    ------
    PartitionError
        If there is no index, it is damaged, or a file is missing or has another size.
    """
    path = folder / _FILE
    try:
        saved = json.loads(path.read_bytes())
        if saved.pop("version") != _VERSION:
            raise PartitionError(
                f"{path}: was written by another version of masat; partition the graph again"
            )
        index = Index(**saved)
        index = replace(index, pieces=[Entry(**entry) for entry in saved["pieces"]])
    except (FileNotFoundError, NotADirectoryError):
        raise PartitionError(
            f"{folder}: holds no partition; make one with masat partition FILE -o {folder}"
        ) from None
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        if isinstance(error, PartitionError):
            raise
        raise PartitionError(f"{path}: is damaged; partition the graph again") from None
    for entry in index.pieces:
        file = folder / entry.file
        if not file.is_file():
            raise missing(file)
        if file.stat().st_size != entry.size:
            raise PartitionError(
                f"{file}: has {file.stat().st_size} bytes in place of {entry.size}: it is damaged "
                "or of another graph; partition the graph again"
            )
    return index
