"""Optimizers; a method is one file here and one line of `OPTIMIZERS`."""

from __future__ import annotations

from time import perf_counter
from typing import Protocol

import numpy as np

from masat import _core
from masat.arrays import Floats
from masat.errors import OptimizationError
from masat.graph import PoseGraph
from masat.optimizers.dogleg import dogleg
from masat.optimizers.equations import (
    BestSoFar,
    Equations,
    normal_equations,
    rounding_level,
    why_singular,
)
from masat.optimizers.gauss_newton import gauss_newton
from masat.optimizers.levenberg_marquardt import levenberg_marquardt
from masat.optimizers.result import Result
from masat.optimizers.saddles import away_from_half_turns
from masat.optimizers.termination import (
    Iteration,
    Outcome,
    Report,
    StopReason,
    Termination,
)
from masat.progress import Progress

__all__ = ["OPTIMIZERS", "Iteration", "Result", "StopReason", "optimize"]


class Optimizer(Protocol):
    """Improves poses until the termination says stop."""

    def __call__(
        self, equations: Equations, poses: Floats, termination: Termination, report: Report
    ) -> Outcome:
        """Return the poses of the lowest chi2, calling `report` after each iteration."""


OPTIMIZERS: dict[str, Optimizer] = {
    "gauss_newton": gauss_newton,
    "levenberg_marquardt": levenberg_marquardt,
    "dogleg": dogleg,
}
SHORT_NAMES = {"gn": "gauss_newton", "lm": "levenberg_marquardt"}


def optimize(
    graph: PoseGraph,
    method: str = "levenberg_marquardt",
    *,
    max_iterations: int = 100,
    relative_tolerance: float = 1e-9,
    absolute_tolerance: float = 0.0,
    gradient_tolerance: float = 0.0,
    threads: int | None = None,
    report: Report | None = None,
    progress: Progress | None = None,
    equations: _core.NormalEquations | None = None,
) -> Result:
    """Minimize chi2, the sum over the edges of e' W e, over the poses of the free nodes.

    Parameters
    ----------
    graph : PoseGraph
        A graph with poses: its own or an initial guess.
    method : str
        One of `masat.optimizers.OPTIMIZERS`: "levenberg_marquardt" ("lm"), "gauss_newton" ("gn"),
        or "dogleg".
    max_iterations : int
        Limit of the iterations.
    relative_tolerance : float
        Stop when 0 <= (chi2 before - chi2 after) / chi2 after is below it (g2o's test, there 1e-6).
    absolute_tolerance : float
        Stop when chi2 changes by no more. Changes within the rounding of the coordinates stop too.
    gradient_tolerance : float
        Stop when no component of the gradient of chi2 is larger (chi2 per meter or radian).
    threads : int, optional
        Threads that factorize. The numbers do not depend on it. Default: as many as pay for this
        graph on this machine.
    report : callable, optional
        Called with the `Iteration` after each; returning True stops.
    progress : Progress, optional
        What limits the time, and decides what Ctrl-C does.
    equations : NormalEquations, optional
        Those of a graph that differs in its poses alone, to be used again.

    Returns
    -------
    Result
        At the poses of the lowest chi2 of all iterations, even if the optimizer did not converge:
        look at `converged` and `message`.

    Raises
    ------
    OptimizationError
        If the graph has no poses, or the method is unknown.
    """
    method = SHORT_NAMES.get(method, method)
    if method not in OPTIMIZERS:
        known = ", ".join([*OPTIMIZERS, *SHORT_NAMES])
        raise OptimizationError(f"unknown optimizer {method!r}; known: {known}")
    if graph.poses is None:
        raise OptimizationError("the graph has no poses: give it some with masat.initialize")
    if max_iterations < 0 or min(relative_tolerance, absolute_tolerance, gradient_tolerance) < 0:
        raise OptimizationError("iteration limit and tolerances must not be negative")
    start = perf_counter()
    progress = progress or Progress()
    if equations is None:
        equations = normal_equations(graph, threads)
    initial = equations.chi2(graph.poses)
    if not np.isfinite(initial):
        raise OptimizationError("chi2 of the initial poses is not finite: they are too far apart")
    history: list[Iteration] = []

    def keep(iteration: Iteration) -> bool:
        history.append(iteration)
        return (report is not None and report(iteration) is True) or progress.over

    termination = Termination(
        max_iterations,
        relative_tolerance,
        absolute_tolerance,
        gradient_tolerance,
        rounding_level(graph),
    )
    if len(graph.gauge) == len(graph.ids):
        outcome = Outcome(graph.poses, initial, StopReason.NOTHING_TO_DO)
    elif initial <= termination.rounding:
        outcome = Outcome(graph.poses, initial, StopReason.ROUNDING)
    else:
        tracked = BestSoFar(equations, graph.poses, initial)
        try:
            outcome = OPTIMIZERS[method](tracked, graph.poses, termination, keep)
            outcome = away_from_half_turns(
                graph, tracked, OPTIMIZERS[method], outcome, termination, keep, len(history)
            )
        except KeyboardInterrupt:
            progress.interrupt()
            outcome = Outcome(tracked.poses, tracked.lowest, StopReason.INTERRUPTED)
    reason = outcome.reason
    if reason is StopReason.MAX_ITERATIONS and history and history[-1].chi2 > initial:
        reason = StopReason.DIVERGED
    return Result(
        graph=graph.with_poses(outcome.poses),
        method=method,
        reason=reason,
        message=_message(graph, reason, outcome, len(history)),
        initial_chi2=initial,
        chi2=outcome.chi2,
        history=tuple(history),
        gauge=graph.gauge,
        seconds=perf_counter() - start,
    )


def _message(graph: PoseGraph, reason: StopReason, outcome: Outcome, iterations: int) -> str:
    said = f"{reason.value} after {iterations} iteration{'' if iterations == 1 else 's'}"
    if reason is StopReason.SINGULAR and outcome.singular_node is not None:
        return f"{said}: {why_singular(graph, outcome.singular_node)}"
    if reason is StopReason.DIVERGED:
        return f"{said}: try Levenberg-Marquardt or another initial guess"
    if reason is StopReason.MAX_ITERATIONS:
        return f"{said}: raise the limit, or try another initial guess"
    if reason is StopReason.STALLED:
        return f"{said}: the poses are as good as rounding allows, or far from any minimum"
    return said
