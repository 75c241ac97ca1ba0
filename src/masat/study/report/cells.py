"""The trials of a study by cell: world and noise level."""

from __future__ import annotations

import csv
from collections import defaultdict
from dataclasses import dataclass, field
from importlib import resources

import numpy as np

from masat.arrays import Floats
from masat.study.names import Sigma, sigma_name
from masat.study.trial import Trial


@dataclass
class Cell:
    """The trials of a world at a noise level, by start and instance."""

    world: str
    sigma: Sigma
    trials: dict[str, dict[int, Trial]] = field(default_factory=lambda: defaultdict(dict))

    @property
    def level(self) -> str:
        """The noise level as text."""
        return f"({sigma_name(self.sigma)})"

    def rate(self, start: str, *, relative: bool = True) -> tuple[int, int]:
        """Return (successes, trials) of a start."""
        trials = self.trials[start].values()
        return sum(t.success(relative=relative) is not None for t in trials), len(trials)

    def successes(self, start: str) -> list[tuple[int, float]]:
        """Return (iterations, reduced chi2) of each success, by the relative threshold."""
        found = []
        for trial in self.trials[start].values():
            k = trial.success()
            if k is not None:
                found.append((k, trial.chi2[k] / trial.degrees_of_freedom))
        return found

    def disagreement(self, one: str, other: str) -> tuple[int, int]:
        """Return on how many instances only the one start succeeds, and only the other."""
        both = self.trials[one].keys() & self.trials[other].keys()
        pairs = [
            (self.trials[one][k].success() is not None, self.trials[other][k].success() is not None)
            for k in both
        ]
        return pairs.count((True, False)), pairs.count((False, True))

    def start_ms(self, start: str) -> Floats:
        """Return the times of the initial guesses, ms."""
        return 1e3 * np.array([t.start_seconds for t in self.trials[start].values()])

    def solve_ms(self, start: str) -> Floats:
        """Return the times of Gauss-Newton, ms."""
        return 1e3 * np.array([t.solve_seconds for t in self.trials[start].values()])


def cells_of(trials: list[Trial]) -> list[Cell]:
    """Sort the trials of noisy worlds into cells, in the order of their first instances."""
    cells: dict[tuple[str, Sigma], Cell] = {}
    for trial in trials:
        case = trial.case
        if case.sigma:
            cell = cells.setdefault((case.world, case.sigma), Cell(case.world, case.sigma))
            cell.trials[trial.start][case.instance] = trial
    return list(cells.values())


def paper_table(number: int) -> dict[tuple[str, Sigma], dict[str, str]]:
    """Return the paper's Table 1 (success rates) or 2 (iterations, reduced chi2) by cell."""
    file = resources.files("masat.study") / "paper" / f"table{number}.csv"
    return {
        (
            row["dataset"],
            (float(row["sigma_x"]), float(row["sigma_y"]), float(row["sigma_theta"])),
        ): row
        for row in csv.DictReader(file.read_text("utf-8").splitlines())
    }
