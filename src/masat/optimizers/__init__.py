"""Optimizers; a method is one file here and one line of `OPTIMIZERS`."""

from __future__ import annotations

from dataclasses import replace
from time import perf_counter
from typing import Any, Protocol

import numpy as np

from masat import _core
from masat.arrays import Flags, Floats
from masat.assembly import Assembly, assemble, needs_assembly
from masat.determinacy import with_undetermined_kept
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
from masat.optimizers.gnc import graduated_truncation
from masat.optimizers.levenberg_marquardt import levenberg_marquardt
from masat.optimizers.losses import GNC_TLS, LOSSES, EdgeLoss, Loss, checked_mask, robust_cost
from masat.optimizers.result import Result
from masat.optimizers.reweighting import robust_equations
from masat.optimizers.saddles import away_from_half_turns
from masat.optimizers.termination import (
    Iteration,
    Outcome,
    Report,
    ReportPoses,
    StopReason,
    Termination,
)
from masat.progress import Progress
from masat.residuals import chi2_per_edge

__all__ = ["LOSSES", "OPTIMIZERS", "Iteration", "Loss", "Result", "StopReason", "optimize"]


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


def check_method(method: str) -> str:
    """Return the full name of an optimizer, if it is known."""
    full = SHORT_NAMES.get(method, method)
    if full not in OPTIMIZERS:
        known = ", ".join([*OPTIMIZERS, *SHORT_NAMES])
        raise OptimizationError(f"unknown optimizer {method!r}; known: {known}")
    return full


def optimize(
    graph: PoseGraph,
    method: str = "levenberg_marquardt",
    *,
    loss: str | Loss | EdgeLoss | None = None,
    scale: float | None = None,
    trusted: Flags | None = None,
    max_iterations: int = 100,
    relative_tolerance: float = 1e-9,
    absolute_tolerance: float = 0.0,
    gradient_tolerance: float = 0.0,
    threads: int | None = None,
    report: Report | None = None,
    report_poses: ReportPoses | None = None,
    progress: Progress | None = None,
    equations: Equations | None = None,
) -> Result:
    """Minimize chi2, the sum of e' W e over all measurements, over the poses of the free nodes.

    The measurements are the edges, the priors and the observations of landmarks, whose points are
    optimized with the poses. What nothing determines stays where it is; the graph's notes say so.

    With a loss, minimize the sum of rho(e' W e) instead, in which wrong edges have little weight.
    Such a cost has more local minima than chi2: a good initial guess matters more.

    Parameters
    ----------
    graph : PoseGraph
        A graph with poses: its own or an initial guess.
    method : str
        One of `masat.optimizers.OPTIMIZERS`: "levenberg_marquardt" ("lm"), "gauss_newton" ("gn"),
        or "dogleg".
    loss : str, Loss or callable, optional
        One of `masat.optimizers.LOSSES` ("cauchy", "geman_mcclure", "huber", "tukey", "dcs",
        "gnc_tls"), described in `Loss`; or a function from chi2 of the edges, (m,), to two arrays
        (m,): costs rho, and weights, their derivatives, which must not be negative. "gnc_tls"
        approaches the truncated loss through stages that are less and less convex.
    scale : float, optional
        Scale of the loss in standard deviations: beyond chi2 = scale^2 an edge counts as doubtful.
        Default: scale^2 is the chi2 that one good edge in 100 exceeds, 11.3 in 2D and 16.8 in 3D.
    trusted : ndarray of bool, (m,), optional
        Edges that keep their chi2 as cost, for instance odometry. Default: none. Priors and
        observations are not trusted.
    max_iterations : int
        Limit of the iterations, with "gnc_tls" of those of each stage.
    relative_tolerance : float
        Stop when 0 <= (chi2 before - chi2 after) / chi2 after is below it (g2o's test, there 1e-6).
    absolute_tolerance : float
        Stop when chi2 changes by no more. Changes within the rounding of the coordinates stop too.
    gradient_tolerance : float
        Stop when no component of the gradient of chi2 is larger (chi2 per meter or radian).
    threads : int, optional
        Threads that compute. The numbers do not depend on it. Default: as many as pay for this
        graph on this machine.
    report : callable, optional
        Called with the `Iteration` after each; returning True stops.
    report_poses : callable, optional
        Called with the poses, (n, 3) or (n, 7) in the order of `graph.ids`: those of the initial
        guess, and then those after each iteration.
    progress : Progress, optional
        What limits the time, and decides what Ctrl-C does.
    equations : Equations, optional
        Those of a graph that differs in its poses alone, to be used again.

    Returns
    -------
    Result
        At the poses of the lowest cost of all iterations, even if the optimizer did not converge:
        look at `converged` and `message`. With a loss, `robust_cost` is what was minimized, `chi2`
        remains the plain chi2 of all edges, and `weights` tells which edges were believed.

    Raises
    ------
    OptimizationError
        If the graph has no poses, the method or the loss is unknown, the scale is not positive, or
        `trusted` has not one entry an edge.
    """
    method = check_method(method)
    if graph.poses is None:
        raise OptimizationError("the graph has no poses: give it some with masat.initialize")
    if needs_assembly(graph):
        if graph.landmarks is not None and graph.points is None:
            raise OptimizationError(
                "the landmarks have no positions: give them some with masat.initialize"
            )
        assembly, notes = with_undetermined_kept(assemble(graph))
        return optimize_assembly(
            assembly.with_notes(notes),
            method,
            loss=loss,
            scale=scale,
            trusted=trusted,
            max_iterations=max_iterations,
            relative_tolerance=relative_tolerance,
            absolute_tolerance=absolute_tolerance,
            gradient_tolerance=gradient_tolerance,
            threads=threads,
            report=report,
            report_poses=report_poses,
            progress=progress,
            equations=equations,
        )
    if max_iterations < 0 or min(relative_tolerance, absolute_tolerance, gradient_tolerance) < 0:
        raise OptimizationError("iteration limit and tolerances must not be negative")
    if loss is None and (scale is not None or trusted is not None):
        raise OptimizationError("scale and trusted have no effect without a loss: give one")
    robust = None if loss is None else robust_cost(graph, loss, scale, trusted)
    start = perf_counter()
    progress = progress or Progress()
    if equations is None:
        equations = normal_equations(graph, threads)
    initial = equations.chi2(graph.poses)
    if not np.isfinite(initial):
        raise OptimizationError("chi2 of the initial poses is not finite: they are too far apart")
    history: list[Iteration] = []
    if report_poses is not None:
        report_poses(graph.poses)

    termination = Termination(
        max_iterations,
        relative_tolerance,
        absolute_tolerance,
        gradient_tolerance,
        rounding_level(graph),
    )

    # Under a loss a residual of half a turn is an outlier, and flat, unless the edge is trusted.
    steep: Flags | slice = slice(None)
    if robust is not None:
        steep = slice(0) if robust.trusted is None else robust.trusted

    def minimize(cost: Equations, poses: Floats, limits: Termination) -> Outcome:
        lowest, before = initial if cost is equations else cost.chi2(poses), len(history)
        if len(graph.gauge) == len(graph.ids):
            return Outcome(poses, lowest, StopReason.NOTHING_TO_DO)
        if lowest <= limits.rounding:
            return Outcome(poses, lowest, StopReason.ROUNDING)
        tracked = BestSoFar(cost, poses, lowest)

        def keep(iteration: Iteration) -> bool:
            history.append(iteration)
            if report_poses is not None:
                report_poses(tracked.latest)
            return (report is not None and report(iteration) is True) or progress.over

        try:
            outcome = OPTIMIZERS[method](tracked, poses, limits, keep)
            outcome = away_from_half_turns(
                graph,
                tracked,
                OPTIMIZERS[method],
                outcome,
                limits,
                keep,
                len(history) - before,
                steep,
            )
        except KeyboardInterrupt:
            progress.interrupt()
            outcome = Outcome(tracked.poses, tracked.lowest, StopReason.INTERRUPTED)
        rose = len(history) > before and history[-1].chi2 > lowest
        if outcome.reason is StopReason.MAX_ITERATIONS and rose:
            return outcome._replace(reason=StopReason.DIVERGED)
        return outcome

    if robust is None:
        outcome = minimize(equations, graph.poses, termination)
    elif not isinstance(equations, _core.NormalEquations):
        raise OptimizationError("with a loss, equations must be a graph's normal equations")
    elif robust.name == GNC_TLS:
        outcome = graduated_truncation(graph, equations, robust, termination, minimize)
    else:
        cost = robust_equations(graph, equations, robust)
        outcome = minimize(cost, graph.poses, termination)
    chi2, costs, weights = outcome.chi2, None, None
    if robust is not None:
        per_edge = chi2_per_edge(graph, outcome.poses)
        chi2 = float(per_edge.sum())
        costs, weights = robust(per_edge)
    return Result(
        graph=graph.with_poses(outcome.poses),
        method=method,
        reason=outcome.reason,
        message=_message(graph, outcome, len(history), weights),
        initial_chi2=initial,
        chi2=chi2,
        history=tuple(history),
        gauge=graph.gauge,
        seconds=perf_counter() - start,
        loss=None if robust is None else robust.name,
        robust_cost=None if costs is None else float(costs.sum()),
        weights=weights,
    )


def optimize_assembly(
    assembly: Assembly,
    method: str,
    *,
    loss: str | Loss | EdgeLoss | None = None,
    trusted: Flags | None = None,
    report_poses: ReportPoses | None = None,
    **options: Any,
) -> Result:
    """Optimize a graph with priors, landmarks or partial edges; parameters as of `optimize`.

    Returns
    -------
    Result
        That of the source: its poses and its landmarks, the weights by kind of measurement.
    """
    source, graph = assembly.source, assembly.graph
    believed = None
    if loss is not None:
        # What keeps rotations of landmarks and undetermined directions costs nothing in any case.
        believed = np.ones(len(graph.edges), np.bool_)
        believed[: assembly.measured] = False
        if trusted is not None:
            believed[: len(source.edges)] = checked_mask(len(source.edges), trusted)
    if report_poses is not None:
        report, at = report_poses, assembly.poses_at
        options["report_poses"] = lambda nodes: report(nodes[at])
    result = optimize(graph, method, loss=loss, trusted=believed, **options)
    result = replace(
        result,
        graph=replace(assembly.disassembled(result.poses), notes=graph.notes),
        gauge=source.gauge,
    )
    if result.weights is None:
        return result
    return replace(
        result,
        weights=result.weights[: len(source.edges)],
        prior_weights=result.weights[assembly.prior_rows],
        observation_weights=result.weights[assembly.observation_rows],
    )


def _message(graph: PoseGraph, outcome: Outcome, iterations: int, weights: Floats | None) -> str:
    advice = None
    if outcome.reason is StopReason.SINGULAR and outcome.singular_node is not None:
        node = outcome.singular_node
        touching = (graph.edge_indices == node).any(axis=1)
        if weights is not None and not weights[touching].any():
            advice = (
                f"the loss gives no weight to the edges around node {graph.ids[node]}; "
                "trust odometry, or take a larger scale or another initial guess"
            )
        else:
            advice = why_singular(graph, node)
    return outcome.reason.said(iterations, advice)
