"""The tables of a store: how trials become rows, and rows trials."""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from dataclasses import asdict
from typing import Any, ClassVar, TypeAlias

from masat.study.cases import AnyTrial
from masat.study.closure_trial import ClosureTrial
from masat.study.names import Case
from masat.study.scores import Scores
from masat.study.trial import Trial

Row: TypeAlias = tuple[Any, ...]


class TrialTable(ABC):
    """A table of trials of one kind.

    Attributes
    ----------
    name : str
        Its name in the file.
    columns : dict
        The type of each column in SQL.
    key : tuple of str
        The columns that name a run: those of its case, and what is compared.
    """

    name: ClassVar[str]
    columns: ClassVar[dict[str, str]]
    key: ClassVar[tuple[str, ...]]

    def sql(self) -> str:
        """Return the command that makes the table where it is missing."""
        columns = ", ".join(f"{name} {kind} NOT NULL" for name, kind in self.columns.items())
        key = ", ".join(self.key)
        return (
            f"CREATE TABLE IF NOT EXISTS {self.name} ({columns}, PRIMARY KEY ({key})) WITHOUT ROWID"
        )

    @abstractmethod
    def named(self, key: Row) -> tuple[Case, str]:
        """Return the run that the key of a row names."""

    @abstractmethod
    def row(self, trial: AnyTrial) -> Row:
        """Return the row of a trial."""

    @abstractmethod
    def trial(self, row: Row) -> AnyTrial:
        """Return the trial of a row; a damaged row is a ValueError or TypeError."""


class _InitTrials(TrialTable):
    name = "trial"
    key = ("world", "sigma", "instance", "init")
    columns: ClassVar = {
        "world": "TEXT",
        "sigma": "TEXT",
        "instance": "INTEGER",
        "init": "TEXT",
        "chi2": "TEXT",
        "degrees_of_freedom": "INTEGER",
        "init_seconds": "REAL",
        "solve_seconds": "REAL",
        "error": "TEXT",
    }

    def named(self, key: Row) -> tuple[Case, str]:
        world, sigma, instance, init = key
        return Case(str(world), _sigma(sigma), int(instance)), str(init)

    def row(self, trial: AnyTrial) -> Row:
        assert isinstance(trial, Trial)
        case = trial.case
        return (
            case.world,
            json.dumps(case.sigma),
            case.instance,
            trial.init,
            json.dumps(trial.chi2),
            trial.degrees_of_freedom,
            trial.init_seconds,
            trial.solve_seconds,
            trial.error,
        )

    def trial(self, row: Row) -> Trial:
        chi2, degrees_of_freedom, init_seconds, solve_seconds, error = row[len(self.key) :]
        case, init = self.named(row[: len(self.key)])
        return Trial(
            case=case,
            init=init,
            chi2=tuple(float(c) for c in json.loads(chi2)),
            degrees_of_freedom=int(degrees_of_freedom),
            init_seconds=float(init_seconds),
            solve_seconds=float(solve_seconds),
            error=str(error),
        )


class _ClosureTrials(TrialTable):
    name = "closure_trial"
    key = ("world", "sigma", "kind", "fraction", "instance", "method")
    columns: ClassVar = {
        "world": "TEXT",
        "sigma": "TEXT",
        "kind": "TEXT",
        "fraction": "REAL",
        "instance": "INTEGER",
        "method": "TEXT",
        "scores": "TEXT",
        "seconds": "REAL",
        "plain_seconds": "REAL",
        "error": "TEXT",
    }

    def named(self, key: Row) -> tuple[Case, str]:
        world, sigma, kind, fraction, instance, method = key
        case = Case(str(world), _sigma(sigma), int(instance), str(kind), float(fraction))
        return case, str(method)

    def row(self, trial: AnyTrial) -> Row:
        assert isinstance(trial, ClosureTrial)
        case = trial.case
        return (
            case.world,
            json.dumps(case.sigma),
            case.kind,
            case.fraction,
            case.instance,
            trial.method,
            json.dumps(None if trial.scores is None else asdict(trial.scores)),
            trial.seconds,
            trial.plain_seconds,
            trial.error,
        )

    def trial(self, row: Row) -> ClosureTrial:
        scores, seconds, plain_seconds, error = row[len(self.key) :]
        case, method = self.named(row[: len(self.key)])
        return ClosureTrial(
            case=case,
            method=method,
            scores=_scores(json.loads(scores)),
            seconds=float(seconds),
            plain_seconds=float(plain_seconds),
            error=str(error),
        )


INIT_TRIALS = _InitTrials()
"""The trials of a study of initial guesses."""

CLOSURE_TRIALS = _ClosureTrials()
"""The trials of a study of false loop closures."""


def _sigma(text: str) -> tuple[float, ...]:
    return tuple(float(s) for s in json.loads(text))


def _scores(table: Any) -> Scores | None:
    if table is None:
        return None
    if not isinstance(table, dict) or not all(isinstance(v, int | float) for v in table.values()):
        raise ValueError("scores that are no numbers")
    return Scores(**table)
