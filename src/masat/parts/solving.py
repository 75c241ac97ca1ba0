"""From a partition to poses of the lowest chi2, on a cluster or in one process."""

from __future__ import annotations

import math
import secrets
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from masat.arrays import Flags, Ids
from masat.errors import OptimizationError, PartitionError
from masat.lie import DOF
from masat.optimizers import SHORT_NAMES
from masat.optimizers.equations import checked_threads
from masat.optimizers.gauss_newton import gauss_newton
from masat.optimizers.levenberg_marquardt import levenberg_marquardt
from masat.optimizers.losses import (
    GNC_TLS,
    LOSSES,
    NamedLoss,
    checked_mask,
    checked_scale,
    default_scale,
)
from masat.optimizers.termination import Iteration, Outcome, Report, StopReason, Termination
from masat.parts.checkpoints import GIVEN, Checkpoint, forget_poses, read_checkpoint
from masat.parts.engines import Engine, InTurn, OnCluster
from masat.parts.guess import GUESSES, initial_guess
from masat.parts.index import Index
from masat.parts.pieces import hash_of, read_rows, read_separators
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
        Sum over the edges of e' W e, without a factor 1/2, at the initial guess (or where a solve
        with another loss had ended) and at the poses of the lowest cost of all iterations.
    history : tuple of Iteration
        chi2 (with a loss, the robust cost), step length, damping and time of each iteration, those
        before an interruption included.
    seconds : float
        Wall time since the solve began or went on.
    loss : str or None
        Name of the loss; None if chi2 was minimized.
    robust_cost : float or None
        With a loss, the minimized cost.
    """

    method: str
    init: str
    reason: StopReason
    message: str
    initial_chi2: float
    chi2: float
    history: tuple[Iteration, ...]
    seconds: float
    loss: str | None = None
    robust_cost: float | None = None

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
    loss: str | None,
    scale: float | None,
    trusted: Flags | None,
    restart: bool,
    client: Any | None,
    memory: int | None,
    threads: int,
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
    checked_threads(threads)
    if loss is None and (scale is not None or trusted is not None):
        raise OptimizationError("scale and trusted have no effect without a loss: give one")
    scaled = None if loss is None else _scaled(loss, scale, DOF[index.dimension])
    mask = checked_mask(index.edges, trusted)
    flags = None if mask is None else _of_pieces(folder, index, mask)
    engine: Engine
    if client is None:
        engine = InTurn(folder, index, memory, scaled, flags, threads)
    else:
        engine = OnCluster(client, folder, index, scaled, flags, threads)
    try:
        return _solve(
            folder,
            index,
            engine,
            method=full,
            init=init,
            loss=scaled,
            trusted=None if mask is None else hash_of(mask),
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
    loss: NamedLoss | None,
    trusted: str | None,
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
        if (checkpoint.loss, checkpoint.trusted) != (loss, trusted):
            # Costs of another loss do not compare: a new solve begins where that one ended.
            history = []
    system = PartSystem(index, engine, separators)
    rounding = system.rounding(poses)
    cost = system.chi2(poses)
    if not math.isfinite(cost):
        raise OptimizationError("chi2 of the initial poses is not finite: they are too far apart")
    if checkpoint is not None and (checkpoint.loss, checkpoint.trusted) == (loss, trusted):
        initial = checkpoint.initial_chi2
    else:
        initial = cost if loss is None else system.chi2_without_loss(poses)
    limits = Termination(max_iterations, relative_tolerance, 0.0, 0.0, rounding())
    # A cluster that loses workers would compute again what nobody needs.
    del rounding

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
            loss=loss,
            trusted=trusted,
        ).save(folder)
        forget_poses(folder, {GIVEN, system.best, system.latest})

    def keep(iteration: Iteration) -> bool:
        history.append(iteration)
        save(None)
        return report is not None and report(iteration) is True

    save(None)
    before = len(history)
    if cost <= limits.rounding:
        outcome = Outcome(poses, cost, StopReason.ROUNDING)
    else:
        outcome = METHODS[method](system, poses, limits, keep)
    reason = outcome.reason
    if reason is StopReason.MAX_ITERATIONS and len(history) > before and history[-1].chi2 > cost:
        reason = StopReason.DIVERGED
    save(reason)
    return PartitionResult(
        method=method,
        init=init,
        reason=reason,
        message=_message(reason, outcome.singular_node, len(history), loss),
        initial_chi2=initial,
        chi2=system.lowest if loss is None else system.chi2_without_loss(system.best),
        history=tuple(history),
        seconds=perf_counter() - begin,
        loss=None if loss is None else loss[0],
        robust_cost=None if loss is None else system.lowest,
    )


def _of_pieces(folder: Path, index: Index, mask: Flags) -> list[bytes]:
    """Return which edges of each piece are in a mask, bit by bit."""
    measured = index.edges + index.priors + index.observations
    out = []
    for entry in index.pieces:
        rows = read_rows(folder / entry.file, index.graph)
        # What keeps rotations of landmarks and undetermined directions costs nothing in any case.
        own = rows >= measured
        edges = rows < index.edges
        own[edges] = mask[rows[edges]]
        out.append(np.packbits(own).tobytes())
    return out


def _scaled(loss: str, scale: float | None, dof: int) -> NamedLoss:
    """Return a loss of the core with its scale."""
    if loss == GNC_TLS or loss not in LOSSES:
        known = ", ".join(name for name in LOSSES if name != GNC_TLS)
        raise OptimizationError(f"unknown loss {loss!r} of a partition; known: {known}")
    return loss, default_scale(dof) if scale is None else checked_scale(scale)


def _initial_poses(
    index: Index, separators: list[Ids], engine: Engine, init: str | None
) -> tuple[str, str]:
    """Return the initial guess and the name of its poses."""
    if init is None:
        init = "given" if index.with_poses else "chordal"
    if init == "given":
        if not index.with_poses:
            raise PartitionError(
                "the graph had no poses: take the initial guess chordal, masat or spanning_tree"
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


def _message(reason: StopReason, node: int | None, iterations: int, loss: NamedLoss | None) -> str:
    advice = None
    if reason is StopReason.SINGULAR and node is not None:
        advice = (
            f"the edges around node {node} do not determine its pose; take another "
            "initial guess, or else Levenberg-Marquardt"
        )
    if reason is StopReason.MAX_ITERATIONS:
        same = "" if loss is None else " with the same loss"
        advice = f"solve again{same} to go on, or try another initial guess"
    return reason.said(iterations, advice)
