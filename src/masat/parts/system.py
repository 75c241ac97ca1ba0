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
            if step is None:
                found: list[Linearization] = self._engine.gather(self._linearize(poses))
            else:
                found = step.finish()[0]
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
        self._count += 1
        target = f"{self._run}-{self._count}"
        solutions = down(self._index, self._engine, tasks.substitute, jobs, messages, target)
        # What every optimizer asks next is asked at once, so that no worker has to wait for it.
        step = _Step(self._engine, solutions, self._linearize(target, solutions))
        roots: list[Message] = self._engine.gather(
            [messages[k] for k, entry in enumerate(pieces) if entry.parent < 0]
        )
        failed = [root.failed for root in roots if root.failed is not None]
        if failed:
            return min(failed)
        self._pending = {target: step}
        return DampedStep(target, step.length, step.predicted)

    def retract(self, poses: str, step: str, /) -> str:
        """Return the poses after a step."""
        return step

    def rounding(self, poses: str) -> Callable[[], float]:
        """Return what waits for the chi2 that the rounding of coordinates alone makes."""
        return self._total(tasks.rounding, poses)

    def chi2_without_loss(self, poses: str) -> float:
        """Return chi2 at poses, without the loss."""
        return self._total(tasks.chi2, poses)()

    def _total(
        self, task: Callable[[tasks.PieceFile, str], float], poses: str
    ) -> Callable[[], float]:
        files = self._engine.files()
        jobs = self._engine.map(task, files, [poses] * len(files))
        return lambda: math.fsum(self._engine.gather(jobs))

    def _linearize(self, poses: str, after: list[Any] | None = None) -> list[Any]:
        """Return what stands for the linearizations of all pieces, after their solutions."""
        files = self._engine.files()
        return self._engine.map(
            tasks.linearize, files, [poses] * len(files), after or [None] * len(files)
        )

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
    """The solutions of all pieces, sums over them, and the linearizations at the poses after them.

    Once they are known the tasks are let go: else a cluster that loses workers would compute again
    what nobody needs.
    """

    def __init__(self, engine: Engine, solutions: list[Any], linearizations: list[Any]) -> None:
        self._engine = engine
        self._tasks = linearizations, solutions
        self._found: tuple[list[Linearization], float, float] | None = None

    def finish(self) -> tuple[list[Linearization], float, float]:
        """Return the linearizations, the squared length and the predicted fall of chi2."""
        if self._found is None:
            linearizations, solutions = self._tasks
            # From the top down: a piece is linearized just after its poses have been written.
            found = self._engine.gather([*linearizations[::-1], *solutions])
            own: list[Solution] = found[len(linearizations) :]
            self._found = (
                found[: len(linearizations)][::-1],
                math.fsum(one.squared for one in own),
                math.fsum(one.predicted for one in own),
            )
            self._tasks = [], []
        return self._found

    def length(self) -> float:
        """Return the length."""
        return math.sqrt(self.finish()[1])

    def predicted(self) -> float:
        """Return the predicted fall of chi2."""
        return self.finish()[2]
