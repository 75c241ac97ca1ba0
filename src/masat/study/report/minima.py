"""Which minima the starts lead to, and in what time."""

from __future__ import annotations

import numpy as np

from masat.study.report.cells import Cell
from masat.study.report.document import Table
from masat.study.trial import Trial

# chi2 this much higher, relatively, is another minimum.
_SAME = 1e-6


def minima_table(cells: list[Cell], starts: tuple[str, ...]) -> Table:
    """Return the share of all runs that succeed and end in the best minimum of their instance.

    The best is the lowest chi2 of all starts.
    """
    rows = []
    for cell in cells:
        best = _lowest(cell, starts)
        row = [cell.world, cell.level]
        for start in starts:
            runs = cell.trials[start]
            reached = [_ends_at(t, best[k]) for k, t in runs.items()]
            row.append(f"{np.mean(reached):.2f}" if reached else "-")
        rows.append(tuple(row))
    return Table("minima", ("world", "noise", *starts), tuple(rows))


def control_table(cells: list[Cell], starts: tuple[str, ...], control: str) -> Table:
    """Return how many successes end above the chi2 of the control's, and by what share at most."""
    rows = []
    for cell in cells:
        row = [cell.world, cell.level]
        for start in starts:
            above = [
                np.divide(min(t.chi2), min(cell.trials[control][k].chi2)) - 1
                for k, t in cell.trials[start].items()
                if t.success() is not None
                and cell.trials[control].get(k, t).chi2
                and not _ends_at(t, min(cell.trials[control].get(k, t).chi2))
            ]
            row.append(f"{len(above)}, {max(above):.0e}" if above else "0")
        rows.append(tuple(row))
    return Table("control", ("world", "noise", *starts), tuple(rows))


def total_table(cells: list[Cell], starts: tuple[str, ...], against: str) -> Table:
    """Return the median total time over that of another start, where both succeed.

    Gauss-Newton counts up to the iteration at which the relative threshold was met.
    """
    rows = []
    for cell in cells:
        others = cell.trials[against]
        row = [cell.world, cell.level, f"{cell.rate(against)[0] / max(len(others), 1):.2f}"]
        for start in starts:
            both = [
                (_total(t), _total(others[k]))
                for k, t in cell.trials[start].items()
                if k in others and t.success() is not None and others[k].success() is not None
            ]
            if both:
                mine, theirs = np.median(both, axis=0)
                row.append(f"{mine / theirs:.2f}")
            else:
                row.append("-")
        rows.append(tuple(row))
    return Table("totals", ("world", "noise", f"{against}'s rate", *starts), tuple(rows))


def _lowest(cell: Cell, starts: tuple[str, ...]) -> dict[int, float]:
    lowest: dict[int, float] = {}
    for start in starts:
        for k, trial in cell.trials[start].items():
            if trial.chi2:
                lowest[k] = min(lowest.get(k, np.inf), *trial.chi2)
    return lowest


def _ends_at(trial: Trial, chi2: float) -> bool:
    # The lowest: after its success Gauss-Newton goes on to the absolute threshold, and may climb.
    return trial.success() is not None and min(trial.chi2) <= chi2 * (1 + _SAME)


def _total(trial: Trial) -> float:
    steps = trial.success() or 0
    return trial.start_seconds + trial.solve_seconds * steps / (len(trial.chi2) - 1)
