"""The trials of a study by cell: a world at a noise level."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field

import numpy as np

from masat.arrays import Floats
from masat.study.names import Sigma, sigma_name
from masat.study.report.glossary import spoken_world
from masat.study.trial import Trial


@dataclass
class Cell:
    """The trials of a world at a noise level, by initial guess and instance."""

    world: str
    sigma: Sigma
    trials: dict[str, dict[int, Trial]] = field(default_factory=lambda: defaultdict(dict))

    @property
    def panel(self) -> str:
        """Title of the panel of a figure."""
        return spoken_world(self.world)

    @property
    def level(self) -> str:
        """The noise level as text."""
        return f"({sigma_name(self.sigma)})"

    def rate(self, init: str, *, relative: bool = True) -> tuple[int, int]:
        """Return (successes, trials) of an initial guess; a failed run is no success."""
        trials = self.trials[init].values()
        return sum(t.success(relative=relative) is not None for t in trials), len(trials)

    def failed(self, init: str) -> bool:
        """Return whether there are runs from an initial guess and all of them failed."""
        trials = self.trials[init].values()
        return len(trials) > 0 and all(t.error for t in trials)

    def successes(self, init: str) -> list[tuple[int, float | None]]:
        """Return (iterations, reduced chi2) of each success by the relative threshold."""
        found = []
        for trial in self.trials[init].values():
            k = trial.success()
            if k is not None:
                found.append((k, trial.reduced_chi2(k)))
        return found

    def disagreement(self, one: str, other: str) -> tuple[int, int]:
        """Return on how many instances only the one initial guess succeeds, and only the other."""
        both = self.trials[one].keys() & self.trials[other].keys()
        pairs = [
            (self.trials[one][k].success() is not None, self.trials[other][k].success() is not None)
            for k in both
        ]
        return pairs.count((True, False)), pairs.count((False, True))

    def finished(self, init: str) -> list[Trial]:
        """Return the trials from an initial guess that did not fail."""
        return [t for t in self.trials[init].values() if not t.error]

    def init_ms(self, init: str) -> Floats:
        """Return the times of the initial guesses in milliseconds."""
        return 1e3 * np.array([t.init_seconds for t in self.finished(init)])

    def solve_ms(self, init: str) -> Floats:
        """Return the times of Gauss-Newton in milliseconds."""
        return 1e3 * np.array([t.solve_seconds for t in self.finished(init)])


def cells_of(trials: list[Trial]) -> list[Cell]:
    """Sort the trials of noisy worlds into cells, in the order of their first trials."""
    cells: dict[tuple[str, Sigma], Cell] = {}
    for trial in trials:
        case = trial.case
        if case.sigma:
            cell = cells.setdefault((case.world, case.sigma), Cell(case.world, case.sigma))
            cell.trials[trial.init][case.instance] = trial
    return list(cells.values())
