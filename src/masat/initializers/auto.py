"""The automatic initial guess."""

from __future__ import annotations

from functools import partial

from masat import _core
from masat.graph import PoseGraph
from masat.initializers.cauchy import cauchy
from masat.initializers.chordal import chordal
from masat.initializers.masat import masat
from masat.initializers.most_informed_first import most_informed_first
from masat.optimality.best import Start, best_minimum
from masat.progress import Progress


def other_guesses(progress: Progress | None) -> list[Start]:
    """Return cheap initial guesses that differ much: where one is wrong, another may not be."""
    return [partial(cauchy, progress=progress), masat, most_informed_first]


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
    found = best_minimum(
        guess, starts=other_guesses(progress), seed=seed, progress=progress, equations=equations
    )
    return guess.with_poses(found.poses, notes=found.notes)
