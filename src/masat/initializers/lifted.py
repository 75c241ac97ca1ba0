"""The lifted start."""

from __future__ import annotations

from masat import relaxation
from masat.arrays import Floats
from masat.errors import OptimizationError
from masat.graph import PoseGraph
from masat.initializers.chordal import chordal
from masat.initializers.roots import rooted
from masat.optimizers import optimize

# Iterations of Gauss-Newton: a longer way leads, as like as not, to a local minimum.
_SOON = 15


def lifted(graph: PoseGraph, root: int | None = None, *, seed: int = 0) -> PoseGraph:
    """Solve the chordal problem to its global minimum, in a higher rank where that takes one.

    Begins at the chordal start, and at what Gauss-Newton soon makes of it. Where the minimum there
    neither is certified nor looks global, its frames are lifted (`masat.relaxation.solve`).
    Sources: Rosen, Carlone, Bandeira, Leonard, SE-Sync, IJRR 2019; Dellaert, Rosen, Wu, Mahony,
    Carlone, Shonan rotation averaging, ECCV 2020.
    """
    guess = chordal(graph)
    near = soon_converged(guess)
    assert guess.poses is not None
    solution = relaxation.solve(
        guess,
        guess.poses if near is None else near,
        trust=near is not None,
        decrease=1e-5,
        seed=seed,
    )
    return rooted(guess, solution.poses, root, [])


def soon_converged(guess: PoseGraph) -> Floats | None:
    """Return the poses to which Gauss-Newton soon converges, or None."""
    try:
        result = optimize(guess, "gauss_newton", max_iterations=_SOON, relative_tolerance=1e-4)
    except OptimizationError:
        return None
    return result.graph.poses if result.converged else None
