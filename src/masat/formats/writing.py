"""From a `PoseGraph` to a file."""

from __future__ import annotations

import gzip
import os
from pathlib import Path

from masat.errors import FormatError
from masat.files import write_atomically
from masat.formats.registry import FORMATS
from masat.graph import PoseGraph


def write(
    graph: PoseGraph,
    path: str | os.PathLike[str],
    *,
    format: str | None = None,  # noqa: A002
) -> None:
    """Write a graph to a file, compressed by gzip if its name ends in .gz.

    The file appears complete or not at all, and reading it gives the same numbers.

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
        If no format of this name, or for a file of this name, can be written.
    OSError
        If the file cannot be written, naming it.
    """
    path = Path(path)
    writable = {name: f.format_graph for name, f in FORMATS.items() if f.format_graph}
    if format is None:
        format = format_of(path)  # noqa: A001
    if not isinstance(format, str) or format not in writable:
        raise FormatError(f"cannot write the format {format!r}; known: {', '.join(writable)}", path)
    text = writable[format](graph)
    if path.suffix.lower() == ".gz":
        text = gzip.compress(text, mtime=0)
    write_atomically(path, text)


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
