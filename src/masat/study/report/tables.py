"""The paper's tables beside ours, and the tests."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from masat.study.report.cells import Cell, paper_table
from masat.study.report.document import Table
from masat.study.statistics import fisher, mcnemar, wilson
from masat.study.trial import Trial

PAPER_INSTANCES = 50


def success_table(cells: list[Cell], starts: tuple[str, ...], *, relative: bool) -> Table:
    """Return Table 1: success rate, 95 % Wilson interval, and the paper's rate.

    A star marks a paper's rate that lies outside our interval.
    """
    paper = paper_table(1)
    known = _published(starts)
    rows = []
    for cell in cells:
        row = [cell.world, cell.level]
        published = paper.get((cell.world, cell.sigma), {})
        for start in starts:
            k, n = cell.rate(start, relative=relative)
            low, high = wilson(k, n)
            row.append(f"{k / n:.2f} [{low:.2f}, {high:.2f}]" if n else "-")
            if start in published:
                theirs = float(published[start])
                row.append(published[start] + ("" if low <= theirs <= high else " *"))
            elif start in known:
                row.append("-")
        rows.append(tuple(row))
    columns = ("world", "noise", *_with_papers(starts, known))
    return Table(f"table1_{'relative' if relative else 'absolute'}", columns, tuple(rows))


def _published(starts: tuple[str, ...]) -> set[str]:
    """Return the starts of which the paper tells rates."""
    return {s for s in starts if any(s in row for row in paper_table(1).values())}


def _with_papers(starts: tuple[str, ...], known: set[str]) -> list[str]:
    return [c for s in starts for c in ((s, "paper") if s in known else (s,))]


def paper_table_test(cells: list[Cell], start: str) -> Table:
    """Return for each cell our rate and the paper's, and whether the two samples differ.

    The paper's rate is one of 50 instances, as uncertain as ours: our interval holds it less often
    than in 95 % of the cells even if the true rates are the same, and never where it is 1 and ours
    is not. Fisher's exact test takes both samples for what they are.
    """
    paper, rows = paper_table(1), []
    for cell in cells:
        published = paper.get((cell.world, cell.sigma), {})
        k, n = cell.rate(start)
        if start not in published or n == 0:
            continue
        low, high = wilson(k, n)
        theirs = float(published[start])
        p = fisher(k, n, round(PAPER_INSTANCES * theirs), PAPER_INSTANCES)
        rows.append(
            (
                cell.world,
                cell.level,
                f"{k / n:.3f}",
                f"[{low:.3f}, {high:.3f}]",
                published[start],
                "yes" if low <= theirs <= high else "no",
                f"{p:.2g}" + (" *" if p < 0.05 else ""),
            )
        )
    columns = ("world", "noise", start, "interval", "paper", "held", "Fisher's p")
    return Table("agreement", columns, tuple(rows))


def outside(cells: list[Cell], start: str) -> list[str]:
    """Return the cells in which the paper's rate lies outside our interval, with both."""
    paper, found = paper_table(1), []
    for cell in cells:
        published = paper.get((cell.world, cell.sigma), {})
        k, n = cell.rate(start)
        low, high = wilson(k, n)
        if start in published and not low <= float(published[start]) <= high:
            found.append(
                f"{cell.world} {cell.level}: {k / n:.2f} in [{low:.2f}, {high:.2f}], paper "
                f"{published[start]}"
            )
    return found


def iterations_table(cells: list[Cell], starts: tuple[str, ...]) -> Table:
    """Return Table 2: mean iterations and mean reduced chi2 of the successes, and the paper's."""
    paper = paper_table(2)
    known = _published(starts)
    rows = []
    for cell in cells:
        row = [cell.world, cell.level]
        published = paper.get((cell.world, cell.sigma), {})
        for start in starts:
            found = cell.successes(start)
            if found:
                iterations, chi2 = np.mean(found, axis=0)
                row.append(f"{iterations:.2f} / {chi2:.3f}")
            else:
                row.append("-")
            if start in known:
                theirs = [published.get(f"{start}_{what}", "") for what in ("iterations", "chi2")]
                row.append(" / ".join(theirs) if all(theirs) else "-")
        rows.append(tuple(row))
    columns = ("world", "noise", *_with_papers(starts, known))
    return Table("table2", columns, tuple(rows))


def mcnemar_table(cells: list[Cell], starts: tuple[str, ...], against: str) -> Table:
    """Return for each start: instances that only it, and only `against`, solves; the p-value."""
    rows = []
    for cell in cells:
        row = [cell.world, cell.level]
        for start in starts:
            one, other = cell.disagreement(start, against)
            row.append(f"{one} : {other}, p = {mcnemar(one, other):.2g}")
        rows.append(tuple(row))
    return Table("mcnemar", ("world", "noise", *(f"{s} : {against}" for s in starts)), tuple(rows))


def time_table(cells: list[Cell], starts: tuple[str, ...]) -> Table:
    """Return the median times of the start and of Gauss-Newton, by world and start."""
    rows = []
    for world in dict.fromkeys(c.world for c in cells):
        for start in starts:
            mine = [c for c in cells if c.world == world]
            begun = np.concatenate([c.start_ms(start) for c in mine])
            solved = np.concatenate([c.solve_ms(start) for c in mine])
            steps = sum(len(t.chi2) - 1 for c in mine for t in c.trials[start].values() if t.chi2)
            if len(begun):
                rows.append(
                    (
                        world,
                        start,
                        f"{np.median(begun):.2f}",
                        f"{np.median(solved):.0f}",
                        f"{solved.sum() / max(steps, 1):.1f}",
                        f"{(begun.sum() + solved.sum()) / 1e3:.0f}",
                    )
                )
    columns = ("world", "start", "guess, ms", "Gauss-Newton, ms", "an iteration, ms", "all, s")
    return Table("times", columns, tuple(rows))


def real_table(trials: Iterable[Trial]) -> Table:
    """Return the runs on real graphs: chi2 before and after, iterations, times."""
    rows = []
    for trial in trials:
        if trial.case.sigma:
            continue
        if trial.error:
            rows.append((trial.case.world, trial.start, trial.error, *("-",) * 5))
            continue
        k = trial.settled()
        best = trial.chi2[k] if k is not None else min(trial.chi2)
        rows.append(
            (
                trial.case.world,
                trial.start,
                f"{trial.chi2[0]:.6g}",
                f"{best:.6g}",
                "-" if k is None else str(k),
                f"{1e3 * trial.start_seconds:.2f}",
                f"{1e3 * trial.solve_seconds:.1f}",
                "converged" if k is not None else "not in the limit",
            )
        )
    columns = (
        "graph",
        "start",
        "initial chi2",
        "final chi2",
        "iterations",
        "guess, ms",
        "Gauss-Newton, ms",
        "end",
    )
    return Table("real", columns, tuple(rows))
