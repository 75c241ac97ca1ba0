"""The normal equations of a graph whose pieces are eliminated apart from each other.

It has the face of those of one process (`masat.optimizers.damped.DampedSystem`): poses are names
of files, and steps are the names of the poses after them.
"""

from __future__ import annotations

import math
import secrets
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from masat.arrays import Floats, Ids
from masat.lie import DOF
from masat.optimizers.damped import LINEAR, MIN_SCALE, DampedStep
from masat.optimizers.termination import largest
from masat.parts import tasks
from masat.parts.elimination import Linearization, Solution
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
        self._at = ""
        self._run, self._count = secrets.token_hex(4), 0
        self.lowest = math.inf
        self.best, self.latest = "", ""

    def chi2(self, poses: str, /) -> float:
        """Return chi2 or the robust cost at poses, and remember those of the lowest."""
        if poses not in self._known:
            files = self._engine.files()
            jobs = self._engine.map(tasks.linearize, files, [poses] * len(files))
            self._know(poses, self._engine.gather(jobs))
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
        known = self._known[self._at]
        jobs: list[tasks.Elimination] = []
        for k, entry in enumerate(self._index.pieces):
            diagonal = None
            if entry.children:
                own = self._separators[k][: entry.own]
                diagonal = known.diagonal[own].ravel()
            jobs.append(tasks.Elimination(self._at, damping, known.floor, diagonal))
        messages = up(self._index, self._engine, tasks.eliminate, jobs)
        self._count += 1
        target = f"{self._run}-{self._count}"
        waiting = down(self._index, self._engine, tasks.substitute, jobs, messages, target)
        found: list[Solution] = self._engine.gather(waiting[::-1])[::-1]
        failed = [one.failed for one in found if one.failed is not None]
        if failed:
            return min(failed)
        self._know(target, [one.after for one in found])
        return DampedStep(
            target,
            length=lambda: math.sqrt(math.fsum(one.step.squared for one in found)),
            predicted=lambda: math.fsum(one.step.predicted for one in found),
        )

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

    def _know(self, poses: str, found: list[Linearization]) -> None:
        """Keep what is known at poses, and at those where the system is set."""
        self._known = {name: self._known[name] for name in self._known if name == self._at}
        self._known[poses] = self._sum(found)

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
