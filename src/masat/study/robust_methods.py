"""The methods that a study of false loop closures compares; a method is one line of `METHODS`."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple, TypeAlias

import numpy as np

from masat.arrays import Flags, Floats
from masat.chain import odometry_edges
from masat.graph import PoseGraph
from masat.initializers import guess_of
from masat.optimizers import LOSSES, Result, optimize
from masat.optimizers.losses import default_scale
from masat.solver import solve


class Answer(NamedTuple):
    """Which edges a method kept, (m,), and the map that it made, (n, 3) or (n, 7)."""

    kept: Flags
    poses: Floats


RobustMethod: TypeAlias = Callable[[PoseGraph, int], Answer]
"""From a graph, whose poses do not count, and the limit of the iterations to an answer."""


def robust(graph: PoseGraph, max_iterations: int) -> Answer:
    """Decide which loop closures to believe: `masat.solve(graph, robust=True)`."""
    result = solve(graph, robust=True, max_iterations=max_iterations)
    assert result.kept is not None
    return Answer(result.kept, result.poses)


def plain(graph: PoseGraph, max_iterations: int) -> Answer:
    """Believe all edges: what `masat.solve(graph)` does, without its warnings."""
    result = plain_map(graph, max_iterations)
    return Answer(np.ones(len(graph.edges), np.bool_), result.poses)


def plain_map(graph: PoseGraph, max_iterations: int) -> Result:
    """Return what `masat.solve(graph)` finds, without its warnings."""
    return optimize(guess_of(graph, "auto"), max_iterations=max_iterations)


def with_loss(graph: PoseGraph, max_iterations: int, *, loss: str) -> Answer:
    """Minimize a loss from odometry, which is trusted.

    The scale of the loss is its default. A loop closure counts as kept up to the chi2 that one
    honest one in 100 exceeds, the square of that scale.
    """
    kept, result = _with_loss(graph, max_iterations, loss)
    return Answer(kept, result.poses)


def geman_mcclure_refit(graph: PoseGraph, max_iterations: int) -> Answer:
    """Minimize the loss of Geman and McClure, and then chi2 of the edges that it kept."""
    kept, result = _with_loss(graph, max_iterations, "geman_mcclure")
    rest = result.graph.without_edges(~kept)
    return Answer(kept, optimize(rest, max_iterations=max_iterations).poses)


def _with_loss(graph: PoseGraph, max_iterations: int, loss: str) -> tuple[Flags, Result]:
    trusted = odometry_edges(graph)
    guess = guess_of(graph, "odometry")
    result = optimize(guess, loss=loss, trusted=trusted, max_iterations=max_iterations)
    gate = default_scale(graph.dof) ** 2
    return trusted | (result.graph.chi2_per_edge <= gate), result


METHODS: dict[str, RobustMethod] = {
    "robust": robust,
    "plain": plain,
    **{loss: partial(with_loss, loss=loss) for loss in LOSSES},
    "geman_mcclure_refit": geman_mcclure_refit,
}
"""The methods by name."""
