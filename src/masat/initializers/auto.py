"""The automatic start."""

from __future__ import annotations

from masat.errors import InitializationError, OptimizationError
from masat.graph import PoseGraph
from masat.initializers.chordal import chordal
from masat.initializers.lifted import lift, near_minimum
from masat.initializers.roots import rooted
from masat.optimizers import optimize


def auto(graph: PoseGraph, root: int | None = None) -> PoseGraph:
    """Begin cheaply, check, and lift only where that leaves doubt.

    The chordal start and Gauss-Newton; if that soon converges to what looks like a global minimum
    (`masat.relaxation.Relaxation.plausible`), it is done. If not, another turn around its weak
    loops is tried (`masat.windings`). Where doubt is left, the lifted start goes on from there, and
    of the two the one that leads to the lower chi2 is taken. The rule is measured in
    docs/starts.md.
    """
    guess = chordal(graph)
    near, trusted = near_minimum(guess)
    if near is None or not trusted:
        lifted = lift(guess, near)
        candidates = [lifted] if near is None else [near, lifted]
        near = min(candidates, key=lambda poses: _where_it_leads(guess.with_poses(poses)))
    return rooted(guess, near, root, [])


def _where_it_leads(graph: PoseGraph) -> tuple[bool, float]:
    """Return whether Gauss-Newton fails, and the chi2 to which it leads: the smaller the better."""
    try:
        result = optimize(graph, "gauss_newton", max_iterations=50, relative_tolerance=1e-6)
    except OptimizationError as error:
        raise InitializationError(f"auto has to optimise, and cannot: {error}") from error
    return not result.converged, result.chi2
