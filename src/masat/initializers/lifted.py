"""The lifted start."""

from __future__ import annotations

from masat import relaxation
from masat.graph import PoseGraph
from masat.initializers.chordal import chordal
from masat.initializers.roots import rooted


def lifted(graph: PoseGraph, root: int | None = None, *, seed: int = 0) -> PoseGraph:
    """Solve the chordal problem to its global minimum, in higher ranks where that takes them.

    Begins at the chordal start; the notes tell whether the minimum is certified. Sources: Rosen,
    Carlone, Bandeira, Leonard, SE-Sync, IJRR 2019; Dellaert, Rosen, Wu, Mahony, Carlone, Shonan
    rotation averaging, ECCV 2020.
    """
    start = chordal(graph)
    assert start.poses is not None
    solution = relaxation.solve(start, start.poses, trust=True, decrease=1e-5, seed=seed)
    return rooted(start, solution.poses, root, [])
