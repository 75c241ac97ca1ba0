"""The lifted start."""

from __future__ import annotations

from masat.arrays import Floats
from masat.errors import InitializationError, OptimizationError
from masat.graph import PoseGraph
from masat.initializers.chordal import chordal
from masat.initializers.roots import rooted
from masat.minima import lower_minimum
from masat.optimizers import Result, optimize
from masat.relaxation import Relaxation

# Iterations of Gauss-Newton: a longer way leads, as like as not, to a local minimum.
_SOON = 15
# Of chi2: what Gauss-Newton's last iteration changes at the most.
_NEAR = 1e-4


def lifted(graph: PoseGraph, root: int | None = None, *, seed: int = 0) -> PoseGraph:
    """Solve the chordal problem to its global minimum, in a higher rank where that takes one.

    Begins at the chordal start, optimised. Where the certificate fails there, the frames around are
    lifted, and what is rounded back is tried for another turn around its weak loops
    (`masat.minima`). Ends at the minimum of the chordal cost, or of chi2 if doubt was left. Sources:
    Rosen, Carlone, Bandeira, Leonard, SE-Sync, IJRR 2019; Dellaert, Rosen, Wu, Mahony, Carlone,
    Shonan rotation averaging, ECCV 2020.
    """
    guess = chordal(graph)
    poses, trusted = best_minimum(guess, seed=seed)
    if trusted:
        relaxed = Relaxation(guess)
        poses = relaxed.poses(relaxed.polish(poses).unknowns)
    return rooted(guess, poses, root, [])


def best_minimum(guess: PoseGraph, *, seed: int = 0) -> tuple[Floats, bool]:
    """Return the poses of the lowest minimum found from a guess.

    And whether that to which the guess led at once looked global.
    """
    try:
        near = _near(guess)
        assert near.graph.poses is not None
        if Relaxation(guess).plausible(near.graph.poses):
            return near.graph.poses, True
        poses = lower_minimum(near.graph, seed=seed).graph.poses
    except OptimizationError as error:
        raise InitializationError(f"this start has to optimise, and cannot: {error}") from error
    assert poses is not None
    return poses, False


def _near(guess: PoseGraph) -> Result:
    """Return the minimum to which a guess leads, to `_NEAR`."""
    soon = optimize(guess, "gauss_newton", max_iterations=_SOON, relative_tolerance=_NEAR)
    return soon if soon.converged else optimize(guess, relative_tolerance=_NEAR)
