"""The automatic initial guess."""

from __future__ import annotations

from masat import _core
from masat.graph import PoseGraph
from masat.initializers.chordal import chordal
from masat.optimality.best import best_minimum
from masat.progress import Progress


def auto(
    graph: PoseGraph,
    *,
    seed: int = 0,
    progress: Progress | None = None,
    equations: _core.NormalEquations | None = None,
) -> PoseGraph:
    """Solve, check whether the minimum looks global, and search on only where it does not.

    Begins with the chordal guess, optimized; see `masat.optimality.best.best_minimum`. The rule
    is measured in docs/reports/initial_guesses.md.

    Parameters
    ----------
    graph : PoseGraph
        The graph.
    seed : int
        Seed of the random noise that the search adds when it raises a rank.
    progress : Progress, optional
        What reports the stages of the search and limits its time.
    equations : NormalEquations, optional
        Those of the graph, to be used again.

    Returns
    -------
    PoseGraph
        The graph at the lowest minimum found.

    Raises
    ------
    InitializationError
        If the graph cannot be optimized.
    """
    guess = chordal(graph)
    found = best_minimum(guess, seed=seed, progress=progress, equations=equations)
    return guess.with_poses(found.poses, notes=found.notes)
