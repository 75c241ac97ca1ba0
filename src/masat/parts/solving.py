"""From a partition to poses of the lowest chi2, on a cluster or in one process."""

from __future__ import annotations

import math
import secrets
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

from masat.arrays import Ids
from masat.errors import OptimizationError, PartitionError
from masat.optimizers import SHORT_NAMES
from masat.optimizers.gauss_newton import gauss_newton
from masat.optimizers.levenberg_marquardt import levenberg_marquardt
from masat.optimizers.termination import Iteration, Outcome, Report, StopReason, Termination
from masat.parts.checkpoints import GIVEN, Checkpoint, forget_poses, read_checkpoint
from masat.parts.engines import Engine, InTurn, OnCluster
from masat.parts.guess import GUESSES, initial_guess
from masat.parts.index import Index
from masat.parts.pieces import read_separators
from masat.parts.system import PartSystem

METHODS = {
    "levenberg_marquardt": levenberg_marquardt,
    "gauss_newton": gauss_newton,
}


@dataclass(frozen=True, repr=False)
class PartitionResult:
    """The outcome of `Partition.solve`; the poses are in the folder of the partition.

    Attributes
    ----------
    method : str
        The optimizer.
    init : str
        The initial guess.
    reason : StopReason
        Why it stopped.
    message : str
        The same in a sentence, with what to do if it did not converge.
    initial_chi2, chi2 : float
        Sum over the edges of e' W e, without a factor 1/2, at the initial guess and at the poses of
        the lowest chi2 of all iterations.
    history : tuple of Iteration
        chi2, step length, damping and time of each iteration, those before an interruption
        included.
    seconds : float
        Wall time since the solve began or went on.
    """

    method: str
    init: str
    reason: StopReason
    message: str
    initial_chi2: float
    chi2: float
    history: tuple[Iteration, ...]
    seconds: float

    @property
    def converged(self) -> bool:
        """Whether the poses are a (local) minimum."""
        return self.reason.converged

    @property
    def iterations(self) -> int:
        """Number of iterations."""
        return len(self.history)

    def __repr__(self) -> str:
        return (
            f"PartitionResult({self.method}: chi2 {self.initial_chi2:.6g} -> {self.chi2:.6g} in "
            f"{self.iterations} iterations, {self.reason.name})"
        )


def solve_partition(
    folder: Path,
    index: Index,
    *,
    method: str,
    init: str | None,
    restart: bool,
    client: Any | None,
    memory: int | None,
    max_iterations: int,
    relative_tolerance: float,
    report: Report | None,
) -> PartitionResult:
    """Solve a partition; parameters as of `Partition.solve`."""
    full = SHORT_NAMES.get(method, method)
    if full not in METHODS:
        raise OptimizationError(
            f"unknown optimizer {method!r} of a partition; known: {', '.join(METHODS)}, "
            f"{', '.join(SHORT_NAMES)}"
        )
    if max_iterations < 0 or relative_tolerance < 0:
        raise OptimizationError("iteration limit and tolerances must not be negative")
    engine: Engine = (
        InTurn(folder, index, memory) if client is None else OnCluster(client, folder, index)
    )
    try:
        return _solve(
            folder,
            index,
            engine,
            method=full,
            init=init,
            restart=restart,
            max_iterations=max_iterations,
            relative_tolerance=relative_tolerance,
            report=report,
        )
    finally:
        engine.release()


def _solve(
    folder: Path,
    index: Index,
    engine: Engine,
    *,
    method: str,
    init: str | None,
    restart: bool,
    max_iterations: int,
    relative_tolerance: float,
    report: Report | None,
) -> PartitionResult:
    begin = perf_counter()
    separators = [read_separators(folder / e.file, index.graph) for e in index.pieces]
    checkpoint = None if restart else read_checkpoint(folder, index.graph)
    if checkpoint is None:
        init, poses = _initial_poses(index, separators, engine, init)
        history: list[Iteration] = []
    else:
        init, poses, history = checkpoint.init, checkpoint.poses, list(checkpoint.history)
    system = PartSystem(index, engine, separators)
    chi2 = system.chi2(poses)
    if not math.isfinite(chi2):
        raise OptimizationError("chi2 of the initial poses is not finite: they are too far apart")
    initial = chi2 if checkpoint is None else checkpoint.initial_chi2
    limits = Termination(max_iterations, relative_tolerance, 0.0, 0.0, system.rounding(poses))

    def save(reason: StopReason | None) -> None:
        Checkpoint(
            graph=index.graph,
            method=method,
            init=init,
            poses=system.best,
            initial_chi2=initial,
            chi2=system.lowest,
            history=history,
            reason=None if reason is None else reason.name,
        ).save(folder)
        forget_poses(folder, {GIVEN, system.best, system.latest})

    def keep(iteration: Iteration) -> bool:
        history.append(iteration)
        save(None)
        return report is not None and report(iteration) is True

    save(None)
    before = len(history)
    if chi2 <= limits.rounding:
        outcome = Outcome(poses, chi2, StopReason.ROUNDING)
    else:
        outcome = METHODS[method](system, poses, limits, keep)
    reason = outcome.reason
    if reason is StopReason.MAX_ITERATIONS and len(history) > before and history[-1].chi2 > chi2:
        reason = StopReason.DIVERGED
    save(reason)
    return PartitionResult(
        method=method,
        init=init,
        reason=reason,
        message=_message(reason, outcome.singular_node, len(history)),
        initial_chi2=initial,
        chi2=system.lowest,
        history=tuple(history),
        seconds=perf_counter() - begin,
    )


def _initial_poses(
    index: Index, separators: list[Ids], engine: Engine, init: str | None
) -> tuple[str, str]:
    """Return the initial guess and the name of its poses."""
    if init is None:
        init = "given" if index.with_poses else "masat"
    if init == "given":
        if not index.with_poses:
            raise PartitionError(
                "the graph had no poses: take the initial guess masat or spanning_tree"
            )
        return init, GIVEN
    if index.world is not None:
        raise PartitionError(
            "the parts of a graph with priors, landmarks or edges of partial information keep the "
            "initial guess that they were cut with: give the graph another one and cut it again"
        )
    if init not in GUESSES:
        raise PartitionError(
            f"unknown initial guess {init!r} of a partition; known: given, {', '.join(GUESSES)}"
        )
    poses = f"guess-{secrets.token_hex(4)}"
    initial_guess(index, separators, engine, init, poses)
    return init, poses


def _message(reason: StopReason, node: int | None, iterations: int) -> str:
    advice = None
    if reason is StopReason.SINGULAR and node is not None:
        advice = (
            f"the edges around node {node} do not determine its pose; take another "
            "initial guess, or else Levenberg-Marquardt"
        )
    if reason is StopReason.MAX_ITERATIONS:
        advice = "solve again to go on, or try another initial guess"
    return reason.said(iterations, advice)
