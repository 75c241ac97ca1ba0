"""Lists of edges of a graph, as the view exports those that are switched off.

A line names an edge, or several, by one, two or three integers:

    17          the edge with this index; edges count from 0 in the order of the file
    12 40       all edges from node 12 to node 40
    12 40 17    the edge with this index, which must lead from node 12 to node 40

What follows a # is a comment.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from masat.arrays import Ids
from masat.errors import FormatError
from masat.formats.text import integer_of, load_text
from masat.graph import PoseGraph


def read_edge_list(path: str | os.PathLike[str], graph: PoseGraph) -> Ids:
    """Read which edges of a graph a list names, for `PoseGraph.without_edges`.

    Parameters
    ----------
    path : path-like
        A text file. Each line is the index of an edge, the ids of the nodes that it joins (from
        and to), or both: from, to, index. With the ids alone all edges from the one to the other
        are named. What follows a # is a comment.
    graph : PoseGraph
        The graph whose edges are meant.

    Returns
    -------
    ndarray of int64, (k,)
        The indices of the edges, ascending.

    Raises
    ------
    FormatError
        If the file names no edge, or a line names none of the graph; it names the line.
    OSError
        If the file cannot be opened or read.
    """
    path = Path(path)
    of_pair: dict[tuple[int, int], list[int]] = {}
    for k, (a, b) in enumerate(graph.edges.tolist()):
        of_pair.setdefault((a, b), []).append(k)
    named: set[int] = set()
    for number, line in enumerate(load_text(path).split(b"\n"), 1):
        words = [word.decode("utf-8", "replace") for word in line.split(b"#")[0].split()]
        if not words:
            continue
        integers = [integer_of(word) for word in words]
        if len(words) > 3 or None in integers:
            raise FormatError(
                f"{' '.join(words)!r:.60} names no edge: expected its index, the ids of the nodes "
                "from and to, or from, to and index",
                path,
                number,
            )
        named.update(_named([k for k in integers if k is not None], graph, of_pair, path, number))
    if not named:
        raise FormatError("the file names no edge", path)
    return np.array(sorted(named), np.int64)


def _named(
    integers: list[int],
    graph: PoseGraph,
    of_pair: dict[tuple[int, int], list[int]],
    path: Path,
    number: int,
) -> list[int]:
    """Return the indices of the edges that a line names."""
    count = len(graph.edges)
    if len(integers) == 1:
        if not 0 <= integers[0] < count:
            raise FormatError(
                f"there is no edge {integers[0]}: the graph has {count} edges, counted from 0",
                path,
                number,
            )
        return integers
    a, b = integers[:2]
    edges = of_pair.get((a, b), [])
    if not edges:
        hint = f"; there is one from {b} to {a}" if (b, a) in of_pair else ""
        raise FormatError(f"the graph has no edge from {a} to {b}{hint}", path, number)
    if len(integers) == 3:
        if integers[2] not in edges:
            raise FormatError(
                f"edge {integers[2]} does not lead from {a} to {b}: the list belongs to another "
                f"file, or edges were added or removed; the index would be {edges[0]}",
                path,
                number,
            )
        return integers[2:]
    return edges
