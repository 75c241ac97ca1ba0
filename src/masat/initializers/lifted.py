"""The lifted start."""

from __future__ import annotations

from masat.arrays import Floats
from masat.errors import InitializationError, OptimizationError
from masat.graph import PoseGraph
from masat.initializers.chordal import chordal
from masat.initializers.roots import rooted
from masat.optimality import relaxation
from masat.optimality.lifting import lift
from masat.optimality.search import LOWER, NEAR, lower_minimum
from masat.optimizers import optimize

# Iterations of Gauss-Newton: a longer way leads, as like as not, to a minimum that is wrong far and
# wide.
_SOON = 15
# Of chi2: changes below it are near enough to a minimum for the check, and for the search.
_ABOUT = 1e-4
# Bytes of a factor: all nodes are lifted where it takes no more, some seconds on one core.
_AFFORDABLE = 3e8


def lifted(graph: PoseGraph, root: int | None = None, *, seed: int = 0) -> PoseGraph:
    """Solve the chordal problem to its global minimum, in a higher rank where that takes one.

    Begins at the minimum near the chordal start. Where that does not look global, lower ones are
    sought around the places that leave doubt (`masat.optimality.search`), and of all nodes together where the
    way to it was long. Ends at the minimum of the chordal cost, or of chi2 if doubt was left.
    Sources: Rosen, Carlone, Bandeira, Leonard, SE-Sync, IJRR 2019; Dellaert, Rosen, Wu, Mahony,
    Carlone, Shonan rotation averaging, ECCV 2020.
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
        near, soon = _near(guess)
        assert near.poses is not None
        relaxed = relaxation.Relaxation(guess)
        if relaxed.plausible(near.poses):
            return near.poses, True
        found = lower_minimum(near, seed=seed)
        if not soon and relaxed.lifted_bytes() <= _AFFORDABLE:
            lifted = guess.with_poses(lift(found.graph, seed=seed))
            other = optimize(lifted, "dogleg", relative_tolerance=NEAR)
            if other.chi2 < found.chi2 * (1 - LOWER):
                found = lower_minimum(other.graph, seed=seed)
    except OptimizationError as error:
        raise InitializationError(f"this start has to optimize, and cannot: {error}") from error
    assert found.graph.poses is not None
    return found.graph.poses, False


def _near(guess: PoseGraph) -> tuple[PoseGraph, bool]:
    """Return the graph near a minimum that a guess leads to, and whether it leads there soon."""
    soon = optimize(guess, "gauss_newton", max_iterations=_SOON, relative_tolerance=_ABOUT)
    if soon.converged:
        return soon.graph, True
    return optimize(guess, "dogleg", relative_tolerance=_ABOUT).graph, False
