"""Links between sessions that are to be merged: a table, or the edges of a graph.

A line of the table names two nodes by the number of their session and their id there, then the pose
of the second as seen from the first, and the upper triangle of the information, row by row:

    0 812 1 17   0.4 -0.1 1.57   50 0 0 50 0 200

In 2D that are 13 numbers, in 3D 32. Without information, after 7 or 11 numbers, it is the identity.
Sessions count from 0. What follows a # is a comment.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TypeAlias

import numpy as np

from masat import lie
from masat.arrays import Floats, Ids
from masat.errors import FormatError
from masat.formats.reading import read_without_warnings
from masat.formats.text import load_text
from masat.graph import PoseGraph

Links: TypeAlias = PoseGraph | tuple[Ids, Floats, Floats]

_ENDS = 4
# How many numbers a line has, by dimension and whether it has information.
_LENGTHS = {
    _ENDS + size + with_information * lie.DOF[d] * (lie.DOF[d] + 1) // 2: (d, with_information)
    for d, size in lie.POSE_SIZE.items()
    for with_information in (False, True)
}


def read_links(path: str | os.PathLike[str]) -> Links:
    """Read the links between sessions, for `masat.merge`.

    Parameters
    ----------
    path : path-like
        A table whose lines are: session, id, session, id, measurement, and the upper triangle of
        the information, which may be left out for the identity. Sessions count from 0, and the ids
        are those of the session's own file. Or a graph in any format, whose edges are the links, in
        the ids of the merged graph.

    Returns
    -------
    PoseGraph or (ends, measurements, information)
        What `masat.merge` takes as `between`.

    Raises
    ------
    FormatError
        If the file holds no links, naming the file, the line, and what was expected there.
    OSError
        If the file cannot be opened or read.
    """
    path = Path(path)
    lines = [
        (number, words)
        for number, line in enumerate(load_text(path).split(b"\n"), 1)
        if (words := line.split(b"#")[0].split())
    ]
    if not lines:
        raise FormatError("the file holds no links", path)
    if not _is_integer(lines[0][1][0]):
        return read_without_warnings(path)
    return _table(lines, path)


def _table(lines: Sequence[tuple[int, list[bytes]]], path: Path) -> Links:
    length = len(lines[0][1])
    if length not in _LENGTHS:
        raise FormatError(
            f"{length} numbers; expected session, id, session, id, then a pose of 3 or 7 numbers, "
            "then nothing or the upper triangle of the information (6 or 21)",
            path,
            lines[0][0],
        )
    ends = np.empty((len(lines), _ENDS), np.int64)
    values = np.empty((len(lines), length - _ENDS))
    for k, (number, words) in enumerate(lines):
        if len(words) != length:
            raise FormatError(
                f"{len(words)} numbers, but the first link has {length}: all must have as many",
                path,
                number,
            )
        for word in words[:_ENDS]:
            if not _is_integer(word):
                raise FormatError(
                    f"{word.decode('utf-8', 'replace')!r:.40} is no session or id, which are "
                    "integers of at most 64 bits",
                    path,
                    number,
                )
        ends[k] = [int(word) for word in words[:_ENDS]]
        try:
            values[k] = [float(word) for word in words[_ENDS:]]
        except ValueError:
            raise FormatError(
                "expected numbers after session, id, session, id", path, number
            ) from None
    dimension, with_information = _LENGTHS[length]
    size, dof = lie.POSE_SIZE[dimension], lie.DOF[dimension]
    information = np.tile(np.eye(dof), (len(lines), 1, 1))
    if with_information:
        row, column = np.triu_indices(dof)
        information[:, row, column] = information[:, column, row] = values[:, size:]
    return ends, np.ascontiguousarray(values[:, :size]), information


def _is_integer(word: bytes) -> bool:
    try:
        return -(2**63) <= int(word) < 2**63
    except ValueError:
        return False
