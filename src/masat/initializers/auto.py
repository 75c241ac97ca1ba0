"""The automatic start."""

from __future__ import annotations

from masat import relaxation
from masat.graph import PoseGraph
from masat.initializers.chordal import chordal
from masat.initializers.roots import rooted
from masat.optimizers import Result, optimize

# Iterations of Gauss-Newton: a longer way leads, as like as not, to a local minimum.
_SOON = 15


def auto(graph: PoseGraph, root: int | None = None) -> PoseGraph:
    """Begin cheaply, check, and lift only where that leaves doubt; the poses come optimised.

    The chordal start and Gauss-Newton; if that converges soon (`_SOON`) to what looks like a global
    minimum (`masat.relaxation.Relaxation.plausible`), it is done. Else the lifted start goes on
    from there, and the poses of the lower chi2 stand. The rule is measured in docs/starts.md.
    """
    guess = chordal(graph)
    first = _optimise(guess, 1e-4)
    poses = first.graph.poses if first.converged else guess.poses
    assert poses is not None
    if first.converged and first.iterations <= _SOON:
        relaxed = relaxation.Relaxation(guess)
        if relaxed.plausible(relaxed.point(poses)):
            return rooted(guess, poses, root, [])
    solution = relaxation.solve(guess, poses, decrease=1e-5)
    second = _optimise(guess.with_poses(solution.poses), 1e-6)
    best = min((first, second), key=lambda result: (not result.converged, result.chi2))
    assert best.graph.poses is not None
    return rooted(guess, best.graph.poses, root, [])


def _optimise(graph: PoseGraph, tolerance: float) -> Result:
    return optimize(graph, "gauss_newton", max_iterations=50, relative_tolerance=tolerance)
