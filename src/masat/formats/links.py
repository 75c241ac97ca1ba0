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

from masat import _checks as checks
from masat import lie
from masat.arrays import Floats, Ids
from masat.errors import FormatError, GraphError
from masat.formats.reading import read_without_warnings
from masat.formats.text import integer_of, load_text, number_of
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
        (number, [word.decode("utf-8", "replace") for word in words])
        for number, line in enumerate(load_text(path).split(b"\n"), 1)
        if (words := line.split(b"#")[0].split())
    ]
    if not lines:
        raise FormatError("the file holds no links", path)
    if integer_of(lines[0][1][0]) is None:
        return read_without_warnings(path)
    return _table(lines, path)


def _table(lines: Sequence[tuple[int, list[str]]], path: Path) -> Links:
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
        for column, word in enumerate(words[:_ENDS]):
            if (integer := integer_of(word)) is None:
                raise FormatError(
                    f"{word!r:.40} is no session or id, which are integers of at most 64 bits",
                    path,
                    number,
                )
            ends[k, column] = integer
        for column, word in enumerate(words[_ENDS:]):
            if (value := number_of(word)) is None:
                raise FormatError(
                    f"{word!r:.40} is no finite number; expected numbers after session, id, "
                    "session, id",
                    path,
                    number,
                )
            values[k, column] = value
    dimension, with_information = _LENGTHS[length]
    size, dof = lie.POSE_SIZE[dimension], lie.DOF[dimension]
    information = np.tile(np.eye(dof), (len(lines), 1, 1))
    if with_information:
        i, j = np.triu_indices(dof)
        information[:, i, j] = information[:, j, i] = values[:, size:]
    measurements = np.ascontiguousarray(values[:, :size])
    pairs = ends[:, [1, 3]]
    try:
        measurements = checks.rotations(measurements, "measurement", pairs, "edge")
        information = checks.information_matrices(information, pairs, dof)
    except GraphError as error:
        raise FormatError(str(error), path, lines[error.edge or 0][0]) from None
    return ends, measurements, information
