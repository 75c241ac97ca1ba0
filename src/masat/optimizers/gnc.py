"""Graduated non-convexity with truncated least squares."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from masat import _core
from masat.arrays import Floats
from masat.graph import PoseGraph
from masat.optimizers.equations import Equations
from masat.optimizers.losses import RobustCost
from masat.optimizers.reweighting import robust_equations
from masat.optimizers.termination import Outcome, StopReason, Termination
from masat.residuals import chi2_per_edge

# The paper's factor from stage to stage.
_GROWTH = 1.4
# Above it the losses differ from the truncated one only within 1 % of scale^2.
_MAX_MU = 100.0
# A stage only has to follow the minimum. On simulated Manhattan worlds 1e-5 needs four times as
# many iterations and rejects no more false closures; 1e-2 loses some true ones.
_STAGE_TOLERANCE = 1e-3

Minimize = Callable[[Equations, Floats, Termination], Outcome]


def graduated_truncation(
    graph: PoseGraph,
    inner: _core.NormalEquations,
    cost: RobustCost,
    termination: Termination,
    minimize: Minimize,
) -> Outcome:
    """Minimize the truncated cost through a sequence of costs that are less and less convex.

    The first cost gives next to no weight to edges that do not fit, but some to all of them. As mu
    grows, those that fit the map gain weight, the others lose theirs. Source: Yang, Antonante,
    Tzoumas, Carlone, Graduated non-convexity for robust spatial perception, RA-L 2020, section IV.
    There, weights are fixed while the poses of a stage are optimized; here they follow the poses,
    so that a stage ends at a minimum of its own cost.

    Parameters
    ----------
    graph : PoseGraph
        A graph with poses, where the first stage begins.
    inner : NormalEquations
        Its equations.
    cost : RobustCost
        The truncated loss, its scale and the trusted edges.
    termination : Termination
        Tolerances of the last stage; its limit of iterations holds for each stage.
    minimize : callable
        The optimizer: from equations, poses and termination to the outcome.

    Returns
    -------
    Outcome
        That of the last stage, whose cost is the truncated one.
    """
    assert graph.poses is not None
    assert cost.scale is not None
    gate = cost.scale**2
    judged = slice(None) if cost.trusted is None else ~cost.trusted
    poses = graph.poses
    rough = replace(termination, relative=max(_STAGE_TOLERANCE, termination.relative))

    def ratios() -> Floats:
        return chi2_per_edge(graph, poses)[judged] / gate

    worst = float(ratios().max(initial=0.0))
    mu = 1 / (2 * worst - 1) if worst > 0.5 else np.inf
    while mu < _MAX_MU:
        loss = _core.Loss(_core.LossKind.TRUNCATED, cost.scale, mu)
        outcome = minimize(robust_equations(graph, inner, replace(cost, loss=loss)), poses, rough)
        poses = outcome.poses
        if outcome.reason in (StopReason.INTERRUPTED, StopReason.SINGULAR):
            return outcome
        u, full = ratios(), mu / (mu + 1)
        if not ((u > full) & (u < 1 / full)).any():
            break  # all weights are 0 or 1
        mu *= _GROWTH
    return minimize(robust_equations(graph, inner, cost), poses, termination)
