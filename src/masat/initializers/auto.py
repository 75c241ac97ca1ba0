"""The automatic start."""

from __future__ import annotations

from masat.graph import PoseGraph
from masat.initializers.chordal import chordal
from masat.initializers.lifted import best_minimum
from masat.initializers.roots import rooted


def auto(graph: PoseGraph, root: int | None = None) -> PoseGraph:
    """Begin cheaply, check, and search on only where that leaves doubt.

    The chordal start, optimized; if the minimum looks global
    (`masat.optimality.relaxation.Relaxation.plausible`), it is the start. If not, lower ones are sought around
    the places that leave doubt (`masat.optimality.search`), and of all nodes together where the way to the
    first was long. The rule is measured in docs/starts.md.
    """
    guess = chordal(graph)
    poses, _ = best_minimum(guess)
    return rooted(guess, poses, root, [])
