"""The graphs of a study by name: the paper's worlds, simulated ones, public graphs and files."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

from masat.errors import GraphError
from masat.graph import PoseGraph
from masat.study.names import StudyError

GROUND_TRUTH = "ground_truth"
"""The initial guess at the noise-free poses: the paper's control."""

MAX_WORLD_SIZE = 10_000_000
"""Largest number of nodes or edges of a simulated world: more do not fit into usual memory."""

_SIZE = re.compile("[1-9][0-9]{0,18}")


def dimension_of(name: str) -> int:
    """Return 2 or 3, the dimension of a world, without loading it.

    Raises
    ------
    StudyError
        If there is no such world, or it is too large.
    """
    parsed = _parse(name)
    return 2 if parsed is None else _simulated_dimension(parsed[0])


@cache
def load_world(name: str) -> PoseGraph:
    """Return the noise-free graph of a world with its true poses.

    Parameters
    ----------
    name : str
        One of the paper's worlds (`masat.datasets.GRID_WORLDS`), or NAME, NAME:NODES or
        NAME:NODES:EDGES with NAME in `masat.worlds.WORLDS`, simulated with seed 0.

    Raises
    ------
    StudyError
        If there is no such world, or it cannot be simulated with that many nodes and edges.
    """
    from masat.datasets import ground_truth
    from masat.worlds import WORLDS

    parsed = _parse(name)
    if parsed is None:
        return ground_truth(name)
    kind, size = parsed
    try:
        return WORLDS[kind](*size, seed=0)
    except GraphError as error:
        raise StudyError(f"the world {name!r} cannot be simulated: {error}") from None
    except MemoryError:
        raise StudyError(f"the world {name!r} does not fit into memory") from None


def is_path(graph: str) -> bool:
    """Return whether a real graph is a file, by its path, and not a public one, by its name."""
    return "/" in graph or "\\" in graph


def load_real(name: str) -> PoseGraph:
    """Return a public graph, or that of a file, as it is.

    If information matrices are not positive semidefinite, every edge gets the identity.
    """
    from masat.datasets import DATASETS, fetch
    from masat.formats.reading import read_without_warnings

    path, format_ = (Path(name), None) if is_path(name) else (fetch(name), DATASETS[name].format)
    # Cases run in threads, and the filters of warnings belong to the whole process.
    return read_without_warnings(path, format=format_, indefinite="identity")


def _parse(name: str) -> tuple[str, list[int]] | None:
    """Return (simulated world, [nodes, edges]), or None for one of the paper's worlds."""
    from masat.datasets import GRID_WORLDS
    from masat.worlds import WORLDS

    if name in GRID_WORLDS:
        return None
    kind, *size = name.split(":")
    if kind not in WORLDS or len(size) > 2 or not all(_SIZE.fullmatch(s) for s in size):
        raise StudyError(
            f"unknown world {name!r}; known: {', '.join(GRID_WORLDS)}, or NAME:NODES:EDGES with "
            f"NAME one of {', '.join(WORLDS)}"
        )
    numbers = [int(s) for s in size]
    if max(numbers, default=0) > MAX_WORLD_SIZE:
        raise StudyError(f"the world {name!r} has more than {MAX_WORLD_SIZE:,} nodes or edges")
    if len(numbers) == 2 and numbers[1] < numbers[0]:
        raise StudyError(
            f"the world {name!r} has no loop closure, so there is nothing to optimize: give it at "
            "least as many edges as nodes"
        )
    return kind, numbers


@cache
def _simulated_dimension(kind: str) -> int:
    from masat.worlds import WORLDS

    return WORLDS[kind](2, 1).dimension
