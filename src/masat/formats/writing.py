"""From a `PoseGraph` to a file."""

from __future__ import annotations

import gzip
import os
from pathlib import Path

from masat.files import write_atomically
from masat.formats.registry import FORMATS
from masat.graph import PoseGraph


def write(
    graph: PoseGraph,
    path: str | os.PathLike[str],
    *,
    format: str = "g2o",  # noqa: A002
) -> None:
    """Write a graph to a file, gzipped if its name ends in .gz.

    The file appears whole or not at all, and reading it gives the same numbers.

    Parameters
    ----------
    graph : PoseGraph
        The graph; without poses, only its edges are written.
    path : path-like
        The file; an existing one is replaced.
    format : str
        One of `masat.formats.FORMATS` that can be written.
    """
    writable = {name: f.format_graph for name, f in FORMATS.items() if f.format_graph}
    if format not in writable:
        raise ValueError(f"cannot write the format {format!r}; known: {', '.join(writable)}")
    text = writable[format](graph)
    path = Path(path)
    if path.suffix == ".gz":
        text = gzip.compress(text, mtime=0)
    write_atomically(path, text)
