"""Tables of ranges and bearings of landmarks, as the Victoria Park data are often published.

A line is one observation: the id of the pose, the id of the landmark, the range in meters, the
bearing in radians, and in 3D the elevation; then perhaps their standard deviations in the same
order:

    pose, landmark, range, bearing
    812, 17, 10.42, 0.31
    813, 17, 9.95, 0.33

Commas or blanks separate the numbers. Names of columns may stand in the first line, and what
follows a # is a comment.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from masat.errors import FormatError, GraphError
from masat.formats.text import load_text
from masat.measurements import Landmarks, range_bearing
from masat.renaming import shifted

# How many numbers a line has, by dimension and whether it has standard deviations.
_LENGTHS = {4: (2, False), 6: (2, True), 5: (3, False), 8: (3, True)}
_IDS = 2


def read_observations(
    path: str | os.PathLike[str],
    *,
    sigma_range: ArrayLike | None = None,
    sigma_bearing: ArrayLike | None = None,
    sigma_elevation: ArrayLike | None = None,
    first_id: int = 0,
) -> Landmarks:
    """Read ranges and bearings of landmarks from a table.

    Parameters
    ----------
    path : path-like
        A file of lines with pose, landmark, range, bearing, and in 3D elevation; then their
        standard deviations, which may be left out. It may be compressed by gzip.
    sigma_range, sigma_bearing, sigma_elevation : float, optional
        Standard deviations in meters and radians for a table that has none, as in
        `masat.range_bearing`.
    first_id : int
        What is added to the ids of the landmarks, which no pose may have.

    Returns
    -------
    Landmarks
        For ``graph.with_landmarks``.

    Raises
    ------
    FormatError
        If the file holds no such table, naming the file, the line, and what was expected there; or
        if standard deviations are neither in the table nor given, or are both.
    OSError
        If the file cannot be opened or read.
    """
    path = Path(path)
    lines: list[int] = []
    ids: list[list[int]] = []
    rows: list[list[float]] = []
    length = 0
    for number, words in _words(path):
        length = length or len(words)
        if length not in _LENGTHS or len(words) != length:
            raise FormatError(
                f"{len(words)} numbers; expected "
                + (
                    f"{length}, as in the lines before"
                    if rows
                    else "pose, landmark, range, bearing, in 3D elevation, then perhaps their "
                    "standard deviations: 4, 6, 5 or 8"
                ),
                path,
                number,
            )
        try:
            ids.append([int(word) for word in words[:_IDS]])
            rows.append([float(word) for word in words[_IDS:]])
        except ValueError:
            raise FormatError(
                "expected two integer ids and then numbers alone", path, number
            ) from None
        lines.append(number)
    if not rows:
        raise FormatError("the file holds no observations", path)
    d, with_sigmas = _LENGTHS[length]
    table = np.array(rows)
    sigmas: list[ArrayLike | None] = [sigma_range, sigma_bearing, sigma_elevation]
    if with_sigmas:
        if any(sigma is not None for sigma in sigmas):
            raise FormatError("the table has standard deviations: give no others", path)
        sigmas = [*table[:, d:].T] + [None] * (3 - d)
    elif sigma_range is None or sigma_bearing is None:
        raise FormatError(
            "the table has no standard deviations: give sigma_range and sigma_bearing", path
        )
    try:
        pairs = np.array(ids, np.int64)
        pairs[:, 1] = shifted(pairs[:, 1], first_id)
        return range_bearing(
            pairs,
            table[:, 0],
            table[:, 1],
            table[:, 2] if d == 3 else None,
            sigma_range=sigmas[0],
            sigma_bearing=sigmas[1],
            sigma_elevation=sigmas[2],
        )
    except OverflowError:
        raise FormatError("ids are integers of at most 64 bits", path) from None
    except GraphError as error:
        line = None if error.edge is None else lines[error.edge]
        raise FormatError(str(error), path, line) from None


def _words(path: Path) -> Iterator[tuple[int, list[bytes]]]:
    """Yield the number and the words of each line, without a first line of names."""
    first = True
    for number, line in enumerate(load_text(path).split(b"\n"), 1):
        words = line.split(b"#")[0].replace(b",", b" ").split()
        if words and not (first and words[0][:1].isalpha()):
            yield number, words
        first = first and not words
