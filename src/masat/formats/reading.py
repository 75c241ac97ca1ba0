"""From a file to a checked `PoseGraph`."""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping
from dataclasses import fields
from itertools import islice
from pathlib import Path
from typing import Any, get_args

import numpy as np

from masat import _core
from masat.arrays import Floats, Stamps
from masat.construction import named_poses
from masat.errors import FormatError, GraphError, InformationError, MasatWarning
from masat.formats.labels import read_labels
from masat.formats.measured import read_measurements, with_measurements
from masat.formats.registry import FORMATS, printable, recognize
from masat.formats.stamps import read_seconds, read_stamps
from masat.formats.table import Format
from masat.formats.text import MAX_BYTES, load_text
from masat.graph import PoseGraph
from masat.information import Repair, nearest_positive_definite

_MAX_TAG_NOTES = 10  # unknown tags with a note of their own; the others share one


def read(
    path: str | os.PathLike[str],
    *,
    format: str | None = None,  # noqa: A002
    indefinite: Repair = "error",
    max_bytes: int = MAX_BYTES,
) -> PoseGraph:
    """Read a pose graph from a file, which may be compressed by gzip.

    Parameters
    ----------
    path : path-like
        A regular file. Its format is recognized by its tags, not by its name.
    format : str, optional
        One of `masat.formats.FORMATS`, for a file whose tags fit several formats (`EDGE2` is both
        iSAM's and TORO's) or mislead.
    indefinite : {"error", "nearest", "identity"}
        What to do if information matrices of edges are not positive semidefinite. "error" refuses
        the file, "nearest" replaces those matrices by the nearest positive-definite ones,
        "identity" gives every edge the identity matrix.
    max_bytes : int
        Largest size of the text, decompressed; a larger one is refused.

    Returns
    -------
    PoseGraph
        Its `notes` list everything that was skipped, assumed or repaired. Each note is also a
        `MasatWarning`.

    Raises
    ------
    FormatError
        If the file holds no graph, naming the file, the line, and what was expected there; if
        `format`, `indefinite` or `max_bytes` is none of the values above; or if the memory does
        not suffice.
    OSError
        If the file cannot be opened or read.
    """
    path = Path(path)
    graph = read_without_warnings(path, format=format, indefinite=indefinite, max_bytes=max_bytes)
    for note in graph.notes:
        warnings.warn(f"{path}: {note}", MasatWarning, stacklevel=2)
    return graph


def read_without_warnings(
    path: Path,
    *,
    format: str | None = None,  # noqa: A002
    indefinite: Repair = "error",
    max_bytes: int = MAX_BYTES,
) -> PoseGraph:
    """Read a pose graph as `read` does, with its notes but without warnings, as threads need it."""
    if indefinite not in get_args(Repair):
        raise FormatError(
            f'indefinite must be "error", "nearest" or "identity", got {indefinite!r}', path
        )
    if not isinstance(max_bytes, int) or max_bytes < 1:
        raise FormatError(f"max_bytes must be a positive integer, got {max_bytes!r}", path)
    try:
        text = load_text(path, max_bytes)
        table, notes = _format(format, text, path)
        if table.read_text is not None:
            return table.read_text(text, path)
        parsed = _parsed(text, table, path)
        return _graph(table, parsed, path, indefinite, notes + _notes(parsed, table.skipped))
    except MemoryError:
        raise FormatError("there is not enough memory to read this file", path) from None


def _parsed(text: bytes, table: Format, path: Path) -> _core.ParsedGraph:
    try:
        return _core.parse(text, table.records)
    except _core.ParseError as error:
        line, message = error.args
        raise FormatError(message, path, line) from None


def _format(name: str | None, text: bytes, path: Path) -> tuple[Format, list[str]]:
    if name is None:
        table, rivals = recognize(text, path)
        return table, [
            f"the tags fit {table.name} and {rival}: read as {table.name}; if it is {rival}, name "
            f'the format (format="{rival}" in Python, --format {rival} on the command line)'
            for rival in rivals
        ]
    if not isinstance(name, str) or name not in FORMATS:
        raise FormatError(f"unknown format {name!r}; known: {', '.join(FORMATS)}", path)
    return FORMATS[name], []


def _notes(parsed: _core.ParsedGraph, skipped: Mapping[str, str]) -> list[str]:
    meanings = {tag.encode(): meaning for tag, meaning in skipped.items()}
    notes = [
        f"{_count(count, 'line')} with the tag {printable(tag)} skipped (first: line {line}): "
        f"{meanings[tag]} are not supported"
        for tag, (count, line) in parsed["unknown"].items()
        if tag in meanings
    ]
    unknown = {tag: seen for tag, seen in parsed["unknown"].items() if tag not in meanings}.items()
    notes += [
        f"{_count(count, 'line')} with the unknown tag {printable(tag)} skipped (first: line "
        f"{line})"
        for tag, (count, line) in islice(unknown, _MAX_TAG_NOTES)
    ]
    if len(unknown) > _MAX_TAG_NOTES:
        more = sum(count for _, (count, _) in islice(unknown, _MAX_TAG_NOTES, None))
        tags = _count(len(unknown) - _MAX_TAG_NOTES, "more unknown tag")
        notes.append(f"{_count(more, 'line')} with {tags} skipped")
    if missing := parsed["edges_without_information"]:
        verb = "has" if missing == 1 else "have"
        notes.append(f"{_count(missing, 'edge')} {verb} no information: assumed the identity")
    return notes


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}" + ("" if number == 1 else "s")


def _graph(
    table: Format,
    parsed: _core.ParsedGraph,
    path: Path,
    indefinite: Repair,
    notes: list[str],
) -> PoseGraph:
    ids, edges = parsed["vertex_ids"], parsed["edge_ids"]
    with_vertices = len(ids) > 0
    priors, landmarks = read_measurements(parsed, path)
    if not with_vertices and len(edges) == 0 and priors is None and landmarks is None:
        raise FormatError("the file holds neither a vertex nor an edge", path)
    points = np.empty(0, np.int64) if landmarks is None else landmarks.ids
    for k in np.flatnonzero(np.isin(parsed["fixed_ids"], points))[:1]:
        raise FormatError(
            f"FIX names the landmark {parsed['fixed_ids'][k]}: only poses can be fixed; give it a "
            "prior of much information instead (EDGE_PRIOR_XY, EDGE_POINTXYZ_PRIOR)",
            path,
            int(parsed["fixed_lines"][k]),
        )
    nodes = ids if with_vertices else named_poses(edges, priors, landmarks)
    for k in np.flatnonzero(~np.isin(parsed["fixed_ids"], nodes))[:1]:
        raise FormatError(
            f"FIX names vertex {parsed['fixed_ids'][k]}, which is not in the file",
            path,
            int(parsed["fixed_lines"][k]),
        )
    information = parsed["information"]
    optional: dict[str, Any] = {}
    if parsed["edge_labels"] is not None and "labels" in {f.name for f in fields(PoseGraph)}:
        optional["labels"] = read_labels(parsed["edge_labels"])

    try:
        stamps = _stamps(table, parsed)
    except GraphError as error:
        raise FormatError(str(error), path, _line(parsed, error)) from None

    def build(matrices: Floats) -> PoseGraph:
        return PoseGraph.from_arrays(
            edges,
            parsed["measurements"],
            matrices,
            ids=nodes,
            poses=parsed["vertex_poses"] if with_vertices else None,
            fixed=parsed["fixed_ids"],
            notes=notes,
            stamps=stamps,
            **optional,
        )

    try:
        try:
            graph = build(information)
        except InformationError as error:
            if indefinite == "error":
                raise InformationError(
                    f'{error}; to repair them, choose "nearest" or "identity" (indefinite="nearest"'
                    " in Python, --indefinite nearest on the command line)",
                    edge=error.edge or 0,
                    count=error.count,
                ) from None
            if indefinite == "nearest":
                how = "replaced by the nearest positive-definite ones"
                repaired = nearest_positive_definite(information)
            else:
                how = "every edge has the identity instead"
                repaired = np.broadcast_to(np.eye(information.shape[1]), information.shape)
            notes.append(f"{error.count} information matrices are not positive semidefinite: {how}")
            graph = build(repaired)
    except GraphError as error:
        raise FormatError(str(error), path, _line(parsed, error)) from None
    return with_measurements(graph, parsed, priors, landmarks, path)


def _stamps(table: Format, parsed: _core.ParsedGraph) -> Stamps | None:
    texts = parsed["vertex_stamps"]
    if texts is None:
        return None
    if "stamps" in table.needs:
        return read_seconds(texts)
    return read_stamps(texts, parsed["vertex_ids"])


def _line(parsed: _core.ParsedGraph, error: GraphError) -> int | None:
    """Return the line of the edge or node that an error names, if it names one."""
    if error.edge is not None:
        return int(parsed["edge_lines"][error.edge])
    if error.node is not None and len(parsed["vertex_lines"]):
        return int(parsed["vertex_lines"][error.node])
    return None
