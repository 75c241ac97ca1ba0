"""From a file to a checked `PoseGraph`."""

from __future__ import annotations

import gzip
import os
import warnings
import zlib
from itertools import islice
from pathlib import Path

import numpy as np

from masat import _core
from masat.arrays import Floats
from masat.errors import FormatError, GraphError, InformationError, MasatWarning
from masat.formats.registry import FORMATS, printable, recognize
from masat.formats.table import Format
from masat.graph import PoseGraph
from masat.information import Repair, nearest_positive_definite

_GZIP = b"\x1f\x8b"
_TAGS_TOLD = 10


def read(
    path: str | os.PathLike[str],
    *,
    format: str | None = None,  # noqa: A002
    indefinite: Repair = "error",
) -> PoseGraph:
    """Read a pose graph from a file, gzipped or not.

    Parameters
    ----------
    path : path-like
        The file. Its format is recognized by its tags, not by its name.
    format : str, optional
        One of `masat.formats.FORMATS`, where the tags leave it open (EDGE2 is iSAM's or TORO's) or
        mislead.
    indefinite : {"error", "nearest", "identity"}
        What to do if information matrices are not positive definite: refuse; raise their
        eigenvalues to the nearest positive-definite ones; give every edge the identity.

    Returns
    -------
    PoseGraph
        Its `notes` tell what was passed over or assumed; each is also a `MasatWarning`.

    Raises
    ------
    FormatError
        Naming the file, the line, and what was expected there.
    OSError
        If the file cannot be read.
    """
    path = Path(path)
    graph = read_without_warnings(path, format=format, indefinite=indefinite)
    for note in graph.notes:
        warnings.warn(f"{path}: {note}", MasatWarning, stacklevel=2)
    return graph


def read_without_warnings(
    path: Path,
    *,
    format: str | None = None,  # noqa: A002
    indefinite: Repair = "error",
) -> PoseGraph:
    """Read a pose graph as `read` does, with its notes but without warnings, as threads need it."""
    if indefinite not in ("error", "nearest", "identity"):
        raise ValueError(f'indefinite must be "error", "nearest" or "identity", got {indefinite!r}')
    text = _text(path)
    table, notes = _format(format, text, path)
    try:
        parsed = _core.parse(text, table.records)
    except _core.ParseError as error:
        line, message = error.args
        raise FormatError(message, path, line) from None
    notes += _remarks(parsed)
    return _graph(parsed, path, indefinite, notes)


def _text(path: Path) -> bytes:
    data = path.read_bytes()
    if not data.startswith(_GZIP):
        return data
    try:
        return gzip.decompress(data)
    except (EOFError, OSError, zlib.error) as error:
        raise FormatError(f"a damaged gzip file: {error}", path) from None


def _format(name: str | None, text: bytes, path: Path) -> tuple[Format, list[str]]:
    if name is None:
        table, rivals = recognize(text, path)
        return table, [
            f"the tags fit {table.name} and {rival}: read as {table.name}; "
            f'choose with format="{rival}"'
            for rival in rivals
        ]
    if name not in FORMATS:
        raise ValueError(f"unknown format {name!r}; known: {', '.join(FORMATS)}")
    return FORMATS[name], []


def _remarks(parsed: _core.ParsedGraph) -> list[str]:
    unknown = parsed["unknown"].items()
    notes = [
        f"{count} lines with the unknown tag {printable(tag)} passed over (first: line {line})"
        for tag, (count, line) in islice(unknown, _TAGS_TOLD)
    ]
    if len(unknown) > _TAGS_TOLD:
        more = sum(count for _, (count, _) in islice(unknown, _TAGS_TOLD, None))
        notes.append(f"{more} lines with {len(unknown) - _TAGS_TOLD} more unknown tags passed over")
    if parsed["edges_without_information"]:
        notes.append(
            f"{parsed['edges_without_information']} edges have no information: identity taken"
        )
    return notes


def _graph(
    parsed: _core.ParsedGraph, path: Path, indefinite: Repair, notes: list[str]
) -> PoseGraph:
    ids, edges = parsed["vertex_ids"], parsed["edge_ids"]
    with_vertices = len(ids) > 0
    if not with_vertices and len(edges) == 0:
        raise FormatError("the file holds neither a vertex nor an edge", path)
    known = np.isin(parsed["fixed_ids"], ids if with_vertices else edges)
    for k in np.flatnonzero(~known)[:1] if len(known) else ():
        raise FormatError(
            f"FIX names vertex {parsed['fixed_ids'][k]}, which is not in the file",
            path,
            int(parsed["fixed_lines"][k]),
        )
    information = parsed["information"]

    def build(matrices: Floats) -> PoseGraph:
        return PoseGraph.from_arrays(
            edges,
            parsed["measurements"],
            matrices,
            ids=ids if with_vertices else None,
            poses=parsed["vertex_poses"] if with_vertices else None,
            fixed=parsed["fixed_ids"],
            notes=notes,
        )

    try:
        try:
            return build(information)
        except InformationError as error:
            if indefinite == "error":
                raise InformationError(
                    f'{error}; go on with indefinite="nearest" or indefinite="identity"',
                    edge=error.edge or 0,
                    count=error.count,
                ) from None
            if indefinite == "nearest":
                how = "replaced by the nearest positive-definite ones"
                repaired = nearest_positive_definite(information)
            else:
                how = "so every edge got the identity"
                repaired = np.broadcast_to(np.eye(information.shape[1]), information.shape)
            notes.append(f"{error.count} information matrices are not positive definite: {how}")
            return build(repaired)
    except GraphError as error:
        raise FormatError(str(error), path, _line(parsed, error)) from None


def _line(parsed: _core.ParsedGraph, error: GraphError) -> int | None:
    if error.edge is not None:
        return int(parsed["edge_lines"][error.edge])
    if error.node is not None and len(parsed["vertex_lines"]):
        return int(parsed["vertex_lines"][error.node])
    return None
