"""The initial guess from the chordal problem, lifted to a higher rank where that is needed."""

from __future__ import annotations

from masat import _core
from masat.graph import PoseGraph
from masat.initializers.auto import other_guesses
from masat.initializers.chordal import chordal
from masat.optimality.best import best_minimum
from masat.optimality.relaxation import polish
from masat.progress import Progress


def lifted(
    graph: PoseGraph,
    *,
    seed: int = 0,
    progress: Progress | None = None,
    equations: _core.NormalEquations | None = None,
) -> PoseGraph:
    """Solve the chordal problem to its global minimum, at a higher rank where that is needed.

    Searches as `auto` does, but ends at the minimum of the chordal cost where the first minimum
    looked global. Sources: Rosen, Carlone, Bandeira, Leonard, SE-Sync, IJRR 2019; Dellaert, Rosen,
    Wu, Mahony, Carlone, Shonan rotation averaging, ECCV 2020. Parameters as of `auto`.
    """
    guess = chordal(graph)
    found = best_minimum(
        guess, starts=other_guesses(progress), seed=seed, progress=progress, equations=equations
    )
    poses = found.poses
    if found.first_is_plausible:
        poses = polish(guess.with_poses(poses))
    return guess.with_poses(poses, notes=found.notes)
