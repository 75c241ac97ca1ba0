"""Reading a graph whose measurements do not fit into memory.

The text is read once, a block of lines at a time. Measurements and information go to files on disk,
which the graph maps into memory as they are used; ids, edges and poses are in memory.
"""

from __future__ import annotations

import gzip
import zlib
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import BinaryIO

import numpy as np

from masat import _checks as checks
from masat import _core, lie
from masat.arrays import Floats, Ids
from masat.errors import FormatError, GraphError
from masat.formats.reading import read_without_warnings
from masat.formats.registry import FORMATS, recognize
from masat.formats.table import Format
from masat.graph import PoseGraph

_BLOCK = 1 << 26  # bytes of text that are parsed at a time
_GZIP = b"\x1f\x8b"
_OTHER_KINDS = ("prior_ids", "point_ids", "observation_ids")


def read_mapped(path: Path, folder: Path, *, format: str | None = None) -> PoseGraph:  # noqa: A002
    """Read a pose graph whose measurements stay on disk.

    Parameters
    ----------
    path : Path
        A file as of `masat.read`. One whose format does not consist of lines, or which has priors
        or landmarks, is read as a whole.
    folder : Path
        A folder for the measurements, which must exist as long as the graph.
    format : str, optional
        As of `masat.read`.

    Returns
    -------
    PoseGraph
        Without stamps and labels.

    Raises
    ------
    FormatError
        As of `masat.read`.
    """
    with path.open("rb") as file:
        compressed = file.read(len(_GZIP)) == _GZIP
    with gzip.open(path, "rb") if compressed else path.open("rb") as text:
        blocks = _blocks(text, path)
        first = next(blocks, b"")
        table = FORMATS[format] if format in FORMATS else recognize(first, path)[0]
        if table.read_text is not None or format not in (None, *FORMATS):
            return read_without_warnings(path, format=format)
        spool = _Spool(path, folder, table)
        with spool.open():
            of_edges_alone = all(map(spool.add, chain([first], blocks)))
        if of_edges_alone:
            return spool.graph()
    return read_without_warnings(path, format=format)


def _blocks(text: BinaryIO | gzip.GzipFile, path: Path) -> Iterator[bytes]:
    """Iterate over blocks of whole lines."""
    rest = b""
    try:
        while data := text.read(_BLOCK):
            end = data.rfind(b"\n") + 1
            if end == 0:
                rest += data
                continue
            yield rest + data[:end]
            rest = data[end:]
    except (EOFError, gzip.BadGzipFile, zlib.error) as error:
        raise FormatError(f"a damaged gzip file: {error}", path) from None
    if rest:
        yield rest


class _Spool:
    """What has been read so far, the measurements on disk."""

    def __init__(self, path: Path, folder: Path, table: Format) -> None:
        self._path, self._table, self._lines = path, table, 0
        self._files = [folder / "measurements", folder / "information"]
        self._written: list[BinaryIO] = []
        self._size = 0
        self._ids: list[Ids] = []
        self._poses: list[Floats] = []
        self._edges: list[Ids] = []
        self._fixed: list[Ids] = []

    def open(self) -> _Spool:
        self._written = [file.open("wb") for file in self._files]
        return self

    def __enter__(self) -> _Spool:
        return self

    def __exit__(self, *_: object) -> None:
        for file in self._written:
            file.close()

    def add(self, block: bytes) -> bool:
        """Add a block of whole lines; return whether all of it are poses and edges."""
        try:
            parsed = _core.parse(block, self._table.records)
        except _core.ParseError as error:
            line, message = error.args
            raise FormatError(message, self._path, line + self._lines) from None
        if any(len(parsed[kind]) for kind in _OTHER_KINDS):  # type: ignore[literal-required]
            return False
        if len(parsed["vertex_ids"]):
            self._ids.append(parsed["vertex_ids"])
            self._poses.append(parsed["vertex_poses"])
        self._fixed.append(parsed["fixed_ids"])
        if len(parsed["edge_ids"]):
            self._add_edges(parsed)
        self._lines += block.count(b"\n")
        return True

    def _add_edges(self, parsed: _core.ParsedGraph) -> None:
        size = parsed["measurements"].shape[1]
        if self._size not in (0, size):
            raise FormatError("holds edges in 2D and in 3D", self._path)
        self._size = size
        try:
            checked = PoseGraph.from_arrays(
                parsed["edge_ids"], parsed["measurements"], parsed["information"]
            )
        except GraphError as error:
            line = None
            if error.edge is not None:
                line = self._lines + int(parsed["edge_lines"][error.edge])
            raise FormatError(str(error), self._path, line) from None
        self._edges.append(checked.edges)
        checked.measurements.tofile(self._written[0])
        checked.information.tofile(self._written[1])

    def graph(self) -> PoseGraph:
        """Return the graph, with its measurements mapped into memory."""
        if not self._edges:
            return read_without_warnings(self._path, format=self._table.name)
        edges = np.concatenate(self._edges)
        self._edges.clear()
        dof = lie.DOF[2 if self._size == 3 else 3]
        try:
            ids, poses = checks.distinct(edges), None
            if self._ids:
                ids, poses = np.concatenate(self._ids), np.concatenate(self._poses)
                if poses.shape[1] != self._size:
                    raise GraphError("the file holds vertices and edges of different dimensions")
                ids = checks.node_ids(ids)
                ids, poses = checks.ascending(ids, checks.rotations(poses, "pose", ids, "node"))
            checks.known_edges(ids, edges)
            fixed = np.unique(np.concatenate(self._fixed))
            checks.known_nodes(ids, fixed, "fixed node")
        except GraphError as error:
            raise FormatError(str(error), self._path) from None
        shapes = [(len(edges), self._size), (len(edges), dof, dof)]
        z, w = (
            np.memmap(file, np.float64, "r", shape=shape)
            for file, shape in zip(self._files, shapes, strict=True)
        )
        return PoseGraph(
            ids=ids, poses=poses, edges=edges, measurements=z, information=w, fixed=fixed
        )
