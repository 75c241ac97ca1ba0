"""The normal equations of a graph whose pieces are eliminated apart from each other.

It has the face of those of one process (`masat.optimizers.damped.DampedSystem`): poses are names
of files, and steps are the names of the poses after them.
"""

from __future__ import annotations

import math
import secrets
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from masat.arrays import Floats, Ids
from masat.lie import DOF
from masat.optimizers.damped import LINEAR, MIN_SCALE, DampedStep
from masat.optimizers.termination import largest
from masat.parts import tasks
from masat.parts.elimination import Linearization, Message, Solution
from masat.parts.engines import Engine
from masat.parts.index import Index
from masat.parts.sweeps import down, up


@dataclass(frozen=True, eq=False)
class _Known:
    """What is known of the system at some poses: sums over all pieces."""

    cost: float
    floor: float
    steepest: float
    diagonal: Floats


class PartSystem:
    """The equations of all pieces.

    Parameters
    ----------
    index : Index
        The index of the partition.
    engine : Engine
        Where tasks run.
    separators : list of ndarray
        `Piece.separators` of each piece.
    """

    def __init__(self, index: Index, engine: Engine, separators: list[Ids]) -> None:
        self._index, self._engine, self._separators = index, engine, separators
        self._dof = DOF[index.dimension]
        self._known: dict[str, _Known] = {}
        self._pending: dict[str, _Step] = {}
        self._at = ""
        self._run, self._count = secrets.token_hex(4), 0
        self.lowest = math.inf
        self.best, self.latest = "", ""

    def chi2(self, poses: str, /) -> float:
        """Return chi2 or the robust cost at poses, and remember those of the lowest."""
        if poses not in self._known:
            step = self._pending.pop(poses, None)
            before: list[Any] = [None] * len(self._index.pieces)
            if step is not None and step.solutions:
                before = step.solutions
            files = self._engine.files()
            # From the top down: a piece is linearized just after its poses have been written.
            jobs = [
                self._engine.submit(k, tasks.linearize, files[k], poses, before[k])
                for k in self._down
            ]
            found: list[Linearization] = self._engine.gather(jobs)[::-1]
            if step is not None:
                step.finish()
            self._known = {name: self._known[name] for name in self._known if name == self._at}
            self._known[poses] = self._sum(found)
        self.latest = poses
        cost = self._known[poses].cost
        if cost < self.lowest:
            self.lowest, self.best = cost, poses
        return cost

    def linearize(self, poses: str, /) -> float:
        """Set the system at poses; return the cost."""
        cost = self.chi2(poses)
        self._at = poses
        return cost

    def steepest(self) -> float:
        """Return the largest absolute value of the gradient's negative half."""
        return self._known[self._at].steepest

    def damped_step(self, damping: float, /) -> DampedStep | int:
        """Return the step, or the id of a node that the damped system does not determine."""
        known, pieces = self._known[self._at], self._index.pieces
        jobs: list[tasks.Elimination] = []
        for k, entry in enumerate(pieces):
            diagonal = None
            if entry.children:
                own = self._separators[k][: entry.own]
                diagonal = known.diagonal[own].ravel()
            jobs.append(tasks.Elimination(self._at, damping, known.floor, diagonal))
        messages = up(self._index, self._engine, tasks.eliminate, jobs)
        roots: list[Message] = self._engine.gather(
            [messages[k] for k, entry in enumerate(pieces) if entry.parent < 0]
        )
        failed = [root.failed for root in roots if root.failed is not None]
        if failed:
            return min(failed)
        self._count += 1
        target = f"{self._run}-{self._count}"
        solutions = down(self._index, self._engine, tasks.substitute, jobs, messages, target)
        step = _Step(self._engine, solutions)
        self._pending = {target: step}
        return DampedStep(target, step.length, step.predicted)

    def retract(self, poses: str, step: str, /) -> str:
        """Return the poses after a step."""
        return step

    def rounding(self, poses: str) -> float:
        """Return the chi2 that the rounding of coordinates alone makes."""
        return self._total(tasks.rounding, poses)

    def chi2_without_loss(self, poses: str) -> float:
        """Return chi2 at poses, without the loss."""
        return self._total(tasks.chi2, poses)

    def _total(self, task: Callable[[tasks.PieceFile, str], float], poses: str) -> float:
        files = self._engine.files()
        jobs = [self._engine.submit(k, task, file, poses) for k, file in enumerate(files)]
        return math.fsum(self._engine.gather(jobs))

    @property
    def _down(self) -> range:
        """The pieces, parents before their children."""
        return range(len(self._index.pieces) - 1, -1, -1)

    def _sum(self, found: list[Linearization]) -> _Known:
        count, d = self._index.separators, self._index.dimension
        diagonal, rhs = np.zeros((count, self._dof)), np.zeros((count, self._dof))
        for own, one in zip(self._separators, found, strict=True):
            diagonal[own] += one.diagonal.reshape(-1, self._dof)
            rhs[own] += one.rhs.reshape(-1, self._dof)
        scale = diagonal.max(axis=0, initial=0.0)
        scale[:d] *= LINEAR
        return _Known(
            math.fsum(one.cost for one in found),
            MIN_SCALE * max(float(scale.max()), *(one.scale for one in found)),
            max(largest(rhs) if count else 0.0, *(one.steepest for one in found)),
            diagonal,
        )


class _Step:
    """The solutions of all pieces, and sums over them.

    Once the sums are known the solutions are let go: else a cluster that loses workers would
    compute again what nobody needs.
    """

    def __init__(self, engine: Engine, solutions: list[Any]) -> None:
        self._engine, self.solutions = engine, solutions
        self._sums: tuple[float, float] | None = None

    def finish(self) -> tuple[float, float]:
        """Return the squared length and the predicted fall of chi2."""
        if self._sums is None:
            found: list[Solution] = self._engine.gather(self.solutions)
            self.solutions = []
            self._sums = (
                math.fsum(one.squared for one in found),
                math.fsum(one.predicted for one in found),
            )
        return self._sums

    def length(self) -> float:
        """Return the length."""
        return math.sqrt(self.finish()[0])

    def predicted(self) -> float:
        """Return the predicted fall of chi2."""
        return self.finish()[1]
