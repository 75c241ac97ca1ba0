"""The automatic start."""

from __future__ import annotations

from masat import relaxation
from masat.errors import InitializationError, OptimizationError
from masat.graph import PoseGraph
from masat.initializers.chordal import chordal
from masat.initializers.lifted import soon_converged
from masat.initializers.roots import rooted
from masat.optimizers import Result, optimize


def auto(graph: PoseGraph, root: int | None = None) -> PoseGraph:
    """Begin cheaply, check, and lift only where that leaves doubt; the poses come optimised.

    The chordal start and Gauss-Newton; if that soon converges to what looks like a global minimum
    (`masat.relaxation.Relaxation.plausible`), it is done. Else the lifted start goes on from there,
    and the poses of the lower chi2 stand. The rule is measured in docs/starts.md.
    """
    guess = chordal(graph)
    near = soon_converged(guess)
    candidates = []
    if near is not None:
        if relaxation.Relaxation(guess).plausible(near):
            return rooted(guess, near, root, [])
        candidates.append(_optimise(guess.with_poses(near)))
    assert guess.poses is not None
    solution = relaxation.solve(guess, guess.poses if near is None else near, decrease=1e-5)
    candidates.append(_optimise(guess.with_poses(solution.poses)))
    best = min(candidates, key=lambda result: (not result.converged, result.chi2))
    assert best.graph.poses is not None
    return rooted(guess, best.graph.poses, root, [])


def _optimise(graph: PoseGraph) -> Result:
    try:
        return optimize(graph, "gauss_newton", max_iterations=50, relative_tolerance=1e-6)
    except OptimizationError as error:
        raise InitializationError(f"auto has to optimise, and cannot: {error}") from error
