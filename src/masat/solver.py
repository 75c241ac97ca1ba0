"""From a pose graph to a map: initial guess, optimization and, on request, the certificate."""

from __future__ import annotations

import warnings
from dataclasses import replace
from functools import partial
from time import perf_counter
from typing import Any

from masat.arrays import Flags
from masat.assembly import Assembly, assemble, needs_assembly
from masat.errors import MasatWarning, OptimizationError
from masat.graph import PoseGraph
from masat.initializers import SEARCHES, guess_of, guess_of_assembly
from masat.initializers.chordal import chordal
from masat.optimality.best import best_minimum
from masat.optimality.certificate import certify as certified
from masat.optimizers import Result, StopReason, check_method, optimize, optimize_assembly
from masat.optimizers.equations import normal_equations
from masat.optimizers.losses import EdgeLoss, Loss
from masat.optimizers.termination import Report, ReportPoses
from masat.outliers import (
    Minimum,
    Suspicion,
    cannot_be_right,
    describe_outliers,
)
from masat.progress import Progress, ReportStage
from masat.robust import decide
from masat.robust.whole import Guess

# Operations that all iterations may take where the map cannot be right: some seconds on one core.
_MAX_OPERATIONS = 3e10


def solve(
    graph: PoseGraph,
    *,
    init: str = "auto",
    optimizer: str = "levenberg_marquardt",
    root: int | None = None,
    certify: bool = False,
    robust: bool = False,
    loss: str | Loss | EdgeLoss | None = None,
    scale: float | None = None,
    trusted: Flags | None = None,
    max_iterations: int = 100,
    relative_tolerance: float = 1e-9,
    threads: int | None = None,
    seed: int = 0,
    budget: float | None = None,
    report: Report | None = None,
    report_poses: ReportPoses | None = None,
    report_stage: ReportStage | None = None,
) -> Result:
    """Make a map of a pose graph: initial guess, optimization and, on request, the certificate.

    Ctrl-C and the end of the time budget return the best map so far, with
    `StopReason.INTERRUPTED`; before there is any map, Ctrl-C raises KeyboardInterrupt.

    Parameters
    ----------
    graph : PoseGraph
        The graph. Its own poses count only for fixed nodes, and for the initial guess "given".
    init : str
        Initial guess, one of `masat.initializers.INITIALIZERS`. The default "auto" needs none and
        searches for the lowest minimum.
    optimizer : str
        "levenberg_marquardt" ("lm"), "gauss_newton" ("gn") or "dogleg".
    root : int, optional
        Id of the node that is placed at the identity and not optimized. Default: the smallest of
        its component. Components with fixed nodes or priors have none.
    certify : bool
        Whether to prove that chi2 is the lowest of all poses (`masat.certify`): one more
        factorization in most cases. No further search is made where there is no proof.
    robust : bool
        Whether to decide first which loop closures to believe, and which priors and observations of
        landmarks (`masat.robust`), and to make the map of these alone. `result.kept`,
        `result.closures` and `result.decision` tell what was decided. No constant needs to be
        chosen; `trusted` names the edges that are believed in any case, by default odometry: the
        first edge of each pair of consecutive ids.
    loss, scale, trusted
        Loss of the edges in the optimization that follows the initial guess, as in
        `masat.optimize`. The initial guess does not know it: "auto" searches for the minimum of
        chi2, wrong edges included, so "odometry" or "cauchy" may be better. Default: chi2.
    max_iterations : int
        Limit of the optimizer's iterations. Where "auto" finds that the map cannot be right, only
        those are made that take a few seconds, which is less than all in large graphs with many
        false loop closures.
    relative_tolerance : float
        The optimizer stops when chi2 falls by a smaller fraction of itself.
    threads : int, optional
        Threads that compute. The numbers do not depend on it. Default: as many as pay for this
        graph on this machine.
    seed : int
        Seed of the random noise that the search adds when it raises a rank.
    budget : float, optional
        Seconds after which the best map so far is returned. Default: no limit.
    report : callable, optional
        Called with the `Iteration` after each iteration of the optimizer; returning True stops it.
    report_poses : callable, optional
        Called with the poses, (n, 3) or (n, 7) in the order of `graph.ids`: those of the initial
        guess, and then those after each iteration of the optimizer.
    report_stage : callable, optional
        Called with a `masat.progress.Stage` at the beginning of each stage of the search.

    Returns
    -------
    Result
        The map is `result.graph`, its poses `result.poses`. Its notes say what the initial guess
        had to assume and, in one sentence, if the map cannot be right or edges contradict it; each
        new note is also a `MasatWarning`.

    Raises
    ------
    InitializationError, OptimizationError
        If the initial guess, the optimizer or the loss is unknown or cannot do what is asked; or if
        a certificate is wanted of a robust cost, for which there is none.
    GraphError
        If the root is not in the graph, or is not fixed in a component that has fixed nodes or
        priors.

    Examples
    --------
    >>> import masat
    >>> graph = masat.PoseGraph.from_arrays(
    ...     edges=[(0, 1), (1, 2), (2, 0)], measurements=[(1, 0, 2.1), (1, 0, 2.1), (1, 0, 2.1)]
    ... )
    >>> result = masat.solve(graph, certify=True)
    >>> result.converged, result.certificate.certified
    (True, True)
    """
    if certify and loss is not None:
        raise OptimizationError(
            "there is no certificate for a robust cost: leave out loss, or certify=True (--certify)"
        )
    check_method(optimizer)
    progress = Progress(budget, report_stage, catch_interrupts=True)
    start = perf_counter()
    rooted = graph if root is None else graph.with_root(root)
    decision = None
    if robust:
        if loss is not None:
            raise OptimizationError("robust and loss exclude each other: choose one of them")
        begin: Guess = partial(guess_of, method=init, seed=seed, progress=progress)
        search: Guess | None = None
        if init == "auto":
            begin, search = chordal, partial(_lowest, seed=seed, progress=progress)
        decision = decide(
            rooted,
            trusted,
            initialize=begin,
            search=search,
            threads=threads,
            progress=progress,
        )
        rooted, trusted = decision.believed(rooted), None
    assembly = None
    guess: PoseGraph
    if needs_assembly(rooted):
        assembly, equations = guess_of_assembly(
            assemble(rooted), init, seed=seed, progress=progress, threads=threads
        )
        guess = assembly.graph
        if decision is not None:
            nodes = assembly.placed(decision.poses, decision.points)
            if equations.chi2(nodes) < guess.chi2:
                assembly = assembly.at(nodes)
                guess = assembly.graph
    elif decision is not None and decision.from_start:
        equations = normal_equations(rooted, threads)
        guess = rooted.with_poses(decision.poses)
    else:
        equations = normal_equations(rooted, threads)
        guess = guess_of(rooted, init, seed=seed, progress=progress, equations=equations)
        if decision is not None and equations.chi2(decision.poses) < guess.chi2:
            guess = guess.with_poses(decision.poses)
    init_seconds = perf_counter() - start
    cut_short = progress.over
    is_plain = loss is None and not robust
    limit = max_iterations
    if is_plain and assembly is None and init == "auto" and cannot_be_right(guess, guess.chi2):
        limit = min(max_iterations, _affordable_iterations(guess))
    options: dict[str, Any] = {
        "loss": loss,
        "scale": scale,
        "trusted": trusted,
        "max_iterations": limit,
        "relative_tolerance": relative_tolerance,
        "report": report,
        "report_poses": report_poses,
        "progress": progress,
        "equations": equations,
    }
    if assembly is None:
        result = optimize(guess, optimizer, **options)
    else:
        result = optimize_assembly(assembly, optimizer, **options)
    if cut_short:
        message = f"{StopReason.INTERRUPTED.value}: the map is the best so far"
        result = replace(result, reason=StopReason.INTERRUPTED, message=message)
    if result.reason is StopReason.MAX_ITERATIONS and limit < max_iterations:
        message = (
            f"stopped after {limit} iterations: the map cannot be right, and more are expensive"
        )
        result = replace(result, message=message)
    certificate = None
    if certify and result.converged:
        certificate = certified(result.graph, search=False, progress=progress, equations=equations)
        if decision is not None:
            message = f"{certificate.message}; this is said of the edges that were kept"
            caveat = certificate.caveat
            if isinstance(caveat, Suspicion):
                caveat = caveat.contradiction
            certificate = replace(certificate, message=message, caveat=caveat)
    doubted = any(isinstance(note, Suspicion) for note in guess.notes)
    if is_plain and (doubted or result.converged):
        known: Minimum = "searched" if init in SEARCHES else "any"
        if certificate is not None and certificate.certified:
            known = "global"
        notes = [note for note in guess.notes if not isinstance(note, Suspicion)]
        notes += describe_outliers(_solved(assembly, result), known)
        result = replace(result, graph=replace(result.graph, notes=tuple(notes)))
    if decision is not None:
        # What was decided is not to be doubted in words that suggest to decide it.
        notes = [note for note in result.graph.notes if not isinstance(note, Suspicion)]
        notes += decision.notes
        result = replace(result, graph=replace(result.graph, notes=tuple(notes)))
    for note in result.graph.notes:
        if note not in graph.notes:
            warnings.warn(note, MasatWarning, stacklevel=2)
    return replace(
        result,
        init=init,
        init_seconds=init_seconds,
        certificate=certificate,
        decision=decision,
    )


def _lowest(graph: PoseGraph, seed: int, progress: Progress) -> PoseGraph:
    """Return a graph at the lowest minimum that is found from its poses."""
    found = best_minimum(graph, seed=seed, progress=progress)
    return graph.with_poses(found.poses, notes=found.notes)


def _solved(assembly: Assembly | None, result: Result) -> PoseGraph:
    """Return the graph that was solved at the poses of the result."""
    if assembly is None:
        return result.graph
    return assembly.at(assembly.placed(result.poses, result.graph.points)).graph


def _affordable_iterations(graph: PoseGraph) -> int:
    """Return how many iterations are worth their time if the map cannot be right."""
    operations = max(graph.elimination.operations(graph.dof), 1.0)
    return int(_MAX_OPERATIONS / operations)
