"""The lifted start."""

from __future__ import annotations

from masat import relaxation
from masat.arrays import Floats
from masat.errors import InitializationError, OptimizationError
from masat.graph import PoseGraph
from masat.initializers.chordal import chordal
from masat.initializers.roots import rooted
from masat.minima import lower_minimum
from masat.optimizers import optimize

# Iterations after which Gauss-Newton is not waited for.
_SOON = 15
# Of chi2: changes below it are near enough to a minimum for the check, and for the search.
_NEAR = 1e-4


def lifted(graph: PoseGraph, root: int | None = None, *, seed: int = 0) -> PoseGraph:
    """Solve the chordal problem to its global minimum, in a higher rank where that takes one.

    Begins at the minimum near the chordal start. Where that does not look global, lower ones are
    sought around the places that leave doubt (`masat.minima`). Ends at the minimum of the chordal
    cost, or of chi2 if doubt was left. Sources: Rosen, Carlone, Bandeira, Leonard, SE-Sync, IJRR
    2019; Dellaert, Rosen, Wu, Mahony, Carlone, Shonan rotation averaging, ECCV 2020.
    """
    guess = chordal(graph)
    poses, trusted = best_minimum(guess, seed=seed)
    if trusted:
        poses = relaxation.solve(guess, poses, lift=False).poses
    return rooted(guess, poses, root, [])


def best_minimum(guess: PoseGraph, *, seed: int = 0) -> tuple[Floats, bool]:
    """Return the poses of the lowest minimum found from a guess.

    And whether that to which the guess led at once looked global.
    """
    try:
        near = _near(guess)
        assert near.poses is not None
        if relaxation.Relaxation(guess).plausible(near.poses):
            return near.poses, True
        poses = lower_minimum(near, seed=seed).graph.poses
    except OptimizationError as error:
        raise InitializationError(f"this start has to optimise, and cannot: {error}") from error
    assert poses is not None
    return poses, False


def _near(guess: PoseGraph) -> PoseGraph:
    """Return the graph near a minimum that a guess leads to."""
    soon = optimize(guess, "gauss_newton", max_iterations=_SOON, relative_tolerance=_NEAR)
    return (
        soon.graph if soon.converged else optimize(guess, "dogleg", relative_tolerance=_NEAR).graph
    )
