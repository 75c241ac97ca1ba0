"""From a `PoseGraph` to a file."""

from __future__ import annotations

import gzip
import os
from pathlib import Path

from masat.errors import FormatError
from masat.files import write_atomically
from masat.formats.registry import FORMATS
from masat.formats.table import Format
from masat.graph import PoseGraph


def write(
    graph: PoseGraph,
    path: str | os.PathLike[str],
    *,
    format: str | None = None,  # noqa: A002
) -> None:
    """Write a graph to a file, compressed by gzip if its name ends in .gz.

    The file appears complete or not at all. Reading a g2o file gives the same numbers. The formats
    of trajectories hold less: "tum" the poses and stamps, "kitti" the poses alone.

    Parameters
    ----------
    graph : PoseGraph
        The graph. Without poses, only its edges are written.
    path : path-like
        The file; an existing one is replaced.
    format : str, optional
        One of `masat.formats.FORMATS` that can be written. Default: the one that `format_of` finds
        by the name of the file.

    Raises
    ------
    FormatError
        If no format of this name, or for a file of this name, can be written; or if the graph lacks
        what the format needs: a trajectory has poses, and one in the format of TUM stamps.
    GraphError
        If the format has no place for what the graph holds, such as two poses at the same time.
    OSError
        If the file cannot be written, naming it.
    """
    path = Path(path)
    table = _writable(format_of(path) if format is None else format, path)
    check_needs(graph, path, table)
    assert table.format_graph is not None
    text = table.format_graph(graph)
    if path.suffix.lower() == ".gz":
        text = gzip.compress(text, mtime=0)
    write_atomically(path, text)


def check_needs(
    graph: PoseGraph, path: Path, table: Format, what: tuple[str, ...] = ("poses", "stamps")
) -> None:
    """Refuse a graph without what a format needs, of the things that are checked."""
    for name in what:
        if name in table.needs and getattr(graph, name) is None:
            advice = {
                "poses": "make a map first, with masat.solve (masat solve)",
                "stamps": "give it stamps with `with_stamps`, or write a KITTI trajectory (.kitti)",
            }
            raise FormatError(
                f"the graph has no {name}, which the format {table.name!r} needs: {advice[name]}",
                path,
            )


def _writable(name: str, path: Path) -> Format:
    writable = [form.name for form in FORMATS.values() if form.format_graph]
    if not isinstance(name, str) or name not in writable:
        raise FormatError(f"cannot write the format {name!r}; known: {', '.join(writable)}", path)
    return FORMATS[name]


def format_of(path: str | os.PathLike[str]) -> str:
    """Return the name of the format that a file is written in, by the suffix of its name.

    Parameters
    ----------
    path : path-like
        The file to be written. A final .gz does not count.

    Returns
    -------
    str
        One of `masat.formats.FORMATS` that can be written.

    Raises
    ------
    FormatError
        If the suffix belongs to no format that can be written.
    """
    path = Path(path)
    name = Path(path.stem) if path.suffix.lower() == ".gz" else path
    suffix = name.suffix.lower()
    known = {s: form.name for form in FORMATS.values() for s in form.suffixes}
    if suffix not in known:
        endings = [s for s in known if s]
        raise FormatError(
            f"the suffix {suffix!r} belongs to no format that can be written; expected "
            f"{', '.join(endings)} or no suffix, each with or without .gz",
            path,
        )
    return known[suffix]
