"""Leaving poses at which chi2 is stationary, or has a kink, without being a minimum.

At a rotation residual of half a turn chi2 has a maximum along that rotation: in 3D its gradient
vanishes there, in 2D the residual jumps from pi to -pi. An optimizer that stops there has found no
minimum.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from masat.arrays import Flags, Floats
from masat.assembly import AssembledGraph
from masat.graph import PoseGraph
from masat.optimizers.equations import Equations
from masat.optimizers.termination import Outcome, Report, StopReason, Termination
from masat.residuals import residuals

# A rotation residual this near to half a turn: radians in 2D, 1 - |vec(q)| in 3D.
_NEAR_HALF_TURN = {2: 1e-2, 3: 1e-3}
# Radians by which rotations are moved at random, and how often an optimizer begins again there.
_NUDGE, _MAX_NUDGES = 1e-2, 3
# An axis with a smaller fraction of the largest information about an axis was not measured.
_UNMEASURED = 1e-14
# chi2 that is lower by this fraction is lower.
_LOWER = 1e-9
_NO_MINIMUM_YET = {StopReason.MAX_ITERATIONS, StopReason.INTERRUPTED, StopReason.DIVERGED}


def away_from_half_turns(
    graph: PoseGraph,
    equations: Equations,
    optimizer: Callable[[Equations, Floats, Termination, Report], Outcome],
    outcome: Outcome,
    termination: Termination,
    report: Report,
    iterations: int,
    edges: Flags | slice = slice(None),
) -> Outcome:
    """Return a lower outcome if an optimizer stopped where residuals are half a turn.

    The rotations of all free nodes are moved a little, by the same random numbers in every run, and
    the optimizer begins again there.

    Parameters
    ----------
    graph : PoseGraph
        The graph.
    equations : Equations
        Its equations.
    optimizer : callable
        The optimizer.
    outcome : Outcome
        What it returned.
    termination : Termination
        Its limits; the iterations so far count.
    report : callable
        Called after each iteration.
    iterations : int
        How many there were.
    edges : ndarray of bool, (m,), or slice
        The edges to look at. Default: all.

    Returns
    -------
    Outcome
    """
    count = iterations

    def counted(iteration: object) -> object:
        nonlocal count
        count += 1
        return report(iteration)  # type: ignore[arg-type]

    rng = np.random.default_rng(0)
    for _ in range(_MAX_NUDGES):
        if outcome.reason in _NO_MINIMUM_YET or not _at_half_turn(graph, outcome.poses, edges):
            break
        steps = rng.normal(scale=_NUDGE, size=(len(graph.ids) - len(graph.gauge), graph.dof))
        steps[:, : graph.dimension] = 0
        nudged = equations.retract(outcome.poses, steps.ravel())
        left = termination.with_iterations(termination.max_iterations - count)
        other = optimizer(equations, nudged, left, counted)
        if not other.chi2 < outcome.chi2 * (1 - _LOWER):
            break
        outcome = other
    return outcome


def _at_half_turn(graph: PoseGraph, poses: Floats, edges: Flags | slice) -> bool:
    d = graph.dimension
    e = residuals(graph, poses)[edges, d:]
    if len(e) == 0:
        return False
    lengths = np.sqrt(np.square(e).sum(axis=1))
    half_turn = np.pi if d == 2 else 1.0
    near = np.flatnonzero(half_turn - lengths < _NEAR_HALF_TURN[d])
    if isinstance(graph, AssembledGraph) and len(near):
        information = graph.information[edges][near, d:, d:]
        # Position fixes measure no rotation at all.
        some = information.any(axis=(1, 2))
        measured = _measured_lengths(e[near[some]], information[some])
        return bool((half_turn - measured < _NEAR_HALF_TURN[d]).any())
    return len(near) > 0


def _measured_lengths(e: Floats, information: Floats) -> Floats:
    """Return the lengths of rotation residuals, (k,), along the axes that were measured."""
    if len(e) == 0:
        return np.empty(0)
    values, axes = np.linalg.eigh(information)
    along = (axes.transpose(0, 2, 1) @ e[..., None])[..., 0]
    measured = values > _UNMEASURED * values[:, -1:]
    lengths: Floats = np.sqrt((measured * np.square(along)).sum(axis=1))
    return lengths
