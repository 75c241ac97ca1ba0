"""The lifted start."""

from __future__ import annotations

from masat import relaxation, windings
from masat.arrays import Floats
from masat.errors import OptimizationError
from masat.graph import PoseGraph
from masat.initializers.chordal import chordal
from masat.initializers.roots import rooted
from masat.optimizers import optimize

# Iterations of Gauss-Newton: a longer way leads, as like as not, to a local minimum.
_SOON = 15
# Of the cost: a step in a higher rank that promises less is the last. At 1e-4 half the steps are
# saved, and some runs end in minima 4 % higher.
_DECREASE = 1e-5


def lifted(graph: PoseGraph, root: int | None = None, *, seed: int = 0) -> PoseGraph:
    """Solve the chordal problem to its global minimum, in a higher rank where that takes one.

    Begins at the chordal start, and at what Gauss-Newton soon makes of it. Where the minimum there
    neither is certified nor looks global, its frames are lifted (`masat.relaxation.solve`), and
    what is rounded back is tried for another turn around its weak loops (`masat.windings`).
    Sources: Rosen, Carlone, Bandeira, Leonard, SE-Sync, IJRR 2019; Dellaert, Rosen, Wu, Mahony,
    Carlone, Shonan rotation averaging, ECCV 2020.
    """
    guess = chordal(graph)
    near, trusted = near_minimum(guess)
    poses = lift(guess, near, seed=seed, trusted=trusted)
    return rooted(guess, poses, root, [])


def lift(guess: PoseGraph, near: Floats | None, *, seed: int = 0, trusted: bool = False) -> Floats:
    """Return the poses of the least chordal cost found from a guess, or from what came of it."""
    assert guess.poses is not None
    start = guess.poses if near is None else near
    solution = relaxation.solve(guess, start, lift=not trusted, decrease=_DECREASE, seed=seed)
    if trusted:
        return solution.poses
    unwound = windings.unwind(guess.with_poses(solution.poses))
    # From the very minimum: Gauss-Newton may leave even the surroundings.
    best = optimize(guess.with_poses(unwound.poses), relative_tolerance=1e-12).graph
    assert best.poses is not None
    return best.poses


def near_minimum(guess: PoseGraph) -> tuple[Floats | None, bool]:
    """Return the best minimum soon found from a guess, if any, and whether it looks global."""
    near = _soon_converged(guess)
    if near is None:
        return None, False
    relaxed = relaxation.Relaxation(guess)
    if relaxed.plausible(near):
        return near, True
    unwound = windings.unwind(guess.with_poses(near))
    return unwound.poses, relaxed.plausible(unwound.poses, unwound.refused)


def _soon_converged(guess: PoseGraph) -> Floats | None:
    """Return the poses to which Gauss-Newton soon converges, or None."""
    try:
        result = optimize(guess, "gauss_newton", max_iterations=_SOON, relative_tolerance=1e-4)
    except OptimizationError:
        return None
    return result.graph.poses if result.converged else None
