"""Which minima the initial guesses lead to, and in what time."""

from __future__ import annotations

import math

import numpy as np

from masat.study.report.cells import Cell
from masat.study.report.document import Table
from masat.study.trial import Trial

# A chi2 that is larger by more than this fraction belongs to another minimum.
_SAME_MINIMUM = 1e-6


def minima_table(cells: list[Cell], inits: tuple[str, ...]) -> Table:
    """Return the fraction of all runs that succeed and end in the best minimum of their instance.

    The best minimum is the lowest chi2 from any initial guess.
    """
    rows = []
    for cell in cells:
        best = _lowest(cell, inits)
        row = [cell.world, cell.level]
        for init in inits:
            runs = cell.trials[init]
            reached = [_ends_at(t, best.get(k, math.inf)) for k, t in runs.items()]
            row.append(f"{np.mean(reached):.2f}" if reached else "-")
        rows.append(tuple(row))
    return Table("minima", ("world", "noise", *inits), tuple(rows))


def control_table(cells: list[Cell], inits: tuple[str, ...], control: str) -> Table:
    """Return how many successes end above the chi2 of the control, and by how much at most."""
    rows = []
    for cell in cells:
        lowest = {k: min(t.chi2) for k, t in cell.trials[control].items() if t.chi2}
        row = [cell.world, cell.level]
        for init in inits:
            above = [
                min(t.chi2) / lowest[k] - 1 if lowest[k] > 0 else math.inf
                for k, t in cell.trials[init].items()
                if t.success() is not None and k in lowest and not _ends_at(t, lowest[k])
            ]
            row.append(f"{len(above)}, {max(above):.0e}" if above else "0")
        rows.append(tuple(row))
    return Table("control", ("world", "noise", *inits), tuple(rows))


def total_table(cells: list[Cell], inits: tuple[str, ...], against: str) -> Table:
    """Return median total times relative to those of another initial guess, where both succeed.

    Gauss-Newton counts up to the iteration at which the relative threshold was met.
    """
    rows = []
    for cell in cells:
        others = cell.trials[against]
        row = [cell.world, cell.level, f"{cell.rate(against)[0] / max(len(others), 1):.2f}"]
        for init in inits:
            both = [
                (_total(t), _total(others[k]))
                for k, t in cell.trials[init].items()
                if k in others and t.success() is not None and others[k].success() is not None
            ]
            if both:
                mine, theirs = np.median(both, axis=0)
                row.append(f"{mine / theirs:.2f}")
            else:
                row.append("-")
        rows.append(tuple(row))
    return Table("totals", ("world", "noise", f"success of {against}", *inits), tuple(rows))


def _lowest(cell: Cell, inits: tuple[str, ...]) -> dict[int, float]:
    """Return the lowest chi2 of each instance of which any run did not fail."""
    lowest: dict[int, float] = {}
    for init in inits:
        for k, trial in cell.trials[init].items():
            if trial.chi2:
                lowest[k] = min(lowest.get(k, math.inf), *trial.chi2)
    return lowest


def _ends_at(trial: Trial, chi2: float) -> bool:
    # The lowest chi2 counts: after its success Gauss-Newton runs on to the absolute threshold, and
    # chi2 may rise.
    return trial.success() is not None and min(trial.chi2) <= chi2 * (1 + _SAME_MINIMUM)


def _total(trial: Trial) -> float:
    steps = trial.success() or 0
    return trial.init_seconds + trial.solve_seconds * steps / (len(trial.chi2) - 1)
