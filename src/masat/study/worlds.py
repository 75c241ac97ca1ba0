"""The worlds of a study by name: the paper's, recovered from public graphs, and simulated ones."""

from __future__ import annotations

from functools import lru_cache

from masat.graph import PoseGraph
from masat.study.names import StudyError

GROUND_TRUTH = "ground_truth"
"""The start at the noise-free poses: the paper's control."""


def check_world(name: str) -> None:
    """Refuse a name that `load_world` does not know."""
    _parse(name)


@lru_cache(maxsize=8)
def load_world(name: str) -> PoseGraph:
    """Return the noise-free truth of a world.

    Parameters
    ----------
    name : str
        One of the paper's worlds (`masat.datasets.GRID_WORLDS`), or NAME:NODES:EDGES with NAME in
        `masat.worlds.WORLDS`, simulated with seed 0.
    """
    from masat.datasets import ground_truth
    from masat.worlds import WORLDS

    size = _parse(name)
    if size is None:
        return ground_truth(name)
    simulated, nodes, edges = size
    return WORLDS[simulated](nodes, edges, seed=0)


def _parse(name: str) -> tuple[str, int, int] | None:
    """Return (simulated world, nodes, edges), or None for one of the paper's."""
    from masat.datasets import GRID_WORLDS
    from masat.worlds import WORLDS

    if name in GRID_WORLDS:
        return None
    simulated, *size = name.split(":")
    if simulated in WORLDS and len(size) == 2 and all(s.isdecimal() for s in size):
        return simulated, int(size[0]), int(size[1])
    raise StudyError(
        f"unknown world {name!r}; known: {', '.join(GRID_WORLDS)}, or NAME:NODES:EDGES with NAME "
        f"one of {', '.join(WORLDS)}"
    )
