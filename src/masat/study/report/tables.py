"""Tables of success rates, iterations, tests and times."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from masat.study.report.cells import Cell
from masat.study.report.document import Table
from masat.study.report.paper import Published
from masat.study.statistics import mcnemar, wilson
from masat.study.trial import Trial

FAILED = "failed"
"""What a table says where all runs failed."""


def success_table(
    cells: list[Cell], inits: tuple[str, ...], paper: Published, *, relative: bool
) -> Table:
    """Return success rates with 95 % Wilson intervals, beside the paper's where it has some.

    A star marks a rate of the paper that lies outside our interval.
    """
    known = paper.inits(cells, inits)
    rows = []
    for cell in cells:
        row = [cell.world, cell.level]
        theirs = paper.rates.get((cell.world, cell.sigma), {})
        for init in inits:
            k, n = cell.rate(init, relative=relative)
            low, high = wilson(k, n)
            if cell.failed(init):
                row.append(FAILED)
            else:
                row.append(f"{k / n:.2f} [{low:.2f}, {high:.2f}]" if n else "-")
            if init in theirs:
                row.append(theirs[init] + ("" if low <= float(theirs[init]) <= high else " *"))
            elif init in known:
                row.append("-")
        rows.append(tuple(row))
    name = f"success_{'relative' if relative else 'absolute'}"
    return Table(name, ("world", "noise", *_with_paper(inits, known)), tuple(rows))


def iterations_table(cells: list[Cell], inits: tuple[str, ...], paper: Published) -> Table:
    """Return mean iterations and mean reduced chi2 of the successes, beside the paper's."""
    known = paper.inits(cells, inits)
    rows = []
    for cell in cells:
        row = [cell.world, cell.level]
        theirs = paper.means.get((cell.world, cell.sigma), {})
        for init in inits:
            found = cell.successes(init)
            iterations = [k for k, _ in found]
            chi2 = [c for _, c in found if c is not None]
            if found:
                mean = f"{np.mean(chi2):.3f}" if chi2 else "-"
                row.append(f"{np.mean(iterations):.2f} / {mean}")
            else:
                row.append(FAILED if cell.failed(init) else "-")
            if init in known:
                means = [theirs.get(f"{init}_{what}", "") for what in ("iterations", "chi2")]
                row.append(" / ".join(means) if all(means) else "-")
        rows.append(tuple(row))
    return Table("iterations", ("world", "noise", *_with_paper(inits, known)), tuple(rows))


def _with_paper(inits: tuple[str, ...], known: set[str]) -> list[str]:
    return [c for i in inits for c in ((i, f"{i} (paper)") if i in known else (i,))]


def mcnemar_table(cells: list[Cell], inits: tuple[str, ...], against: str) -> Table:
    """Return for each initial guess how often only it, and only `against`, succeeds; p-values."""
    rows = []
    for cell in cells:
        row = [cell.world, cell.level]
        for init in inits:
            one, other = cell.disagreement(init, against)
            row.append(f"{one} : {other}, p = {mcnemar(one, other):.2g}")
        rows.append(tuple(row))
    return Table("mcnemar", ("world", "noise", *(f"{i} : {against}" for i in inits)), tuple(rows))


def time_table(cells: list[Cell], inits: tuple[str, ...]) -> Table:
    """Return the times of the initial guess and of Gauss-Newton by world and initial guess."""
    rows = []
    for world in dict.fromkeys(c.world for c in cells):
        for init in inits:
            mine = [c for c in cells if c.world == world]
            guess = np.concatenate([c.init_ms(init) for c in mine])
            solve = np.concatenate([c.solve_ms(init) for c in mine])
            steps = sum(len(t.chi2) - 1 for c in mine for t in c.finished(init))
            if len(guess):
                rows.append(
                    (
                        world,
                        init,
                        f"{np.median(guess):.2f}",
                        f"{np.median(solve):.0f}",
                        f"{solve.sum() / max(steps, 1):.1f}",
                        f"{(guess.sum() + solve.sum()) / 1e3:.0f}",
                    )
                )
    columns = (
        "world",
        "initial guess",
        "initial guess, ms",
        "Gauss-Newton, ms",
        "an iteration, ms",
        "all runs, s",
    )
    return Table("times", columns, tuple(rows))


def real_table(trials: Iterable[Trial]) -> Table:
    """Return the runs on real graphs: chi2 before and after, iterations, times."""
    rows = []
    for trial in trials:
        if trial.case.sigma:
            continue
        if trial.error:
            rows.append((trial.case.world, trial.init, *("-",) * 5, f"{FAILED}: {trial.error}"))
            continue
        k = trial.convergence()
        best = trial.chi2[k] if k is not None else min(trial.chi2)
        rows.append(
            (
                trial.case.world,
                trial.init,
                f"{trial.chi2[0]:.6g}",
                f"{best:.6g}",
                "-" if k is None else str(k),
                f"{1e3 * trial.init_seconds:.2f}",
                f"{1e3 * trial.solve_seconds:.1f}",
                "converged" if k is not None else "did not converge",
            )
        )
    columns = (
        "graph",
        "initial guess",
        "initial chi2",
        "final chi2",
        "iterations",
        "initial guess, ms",
        "Gauss-Newton, ms",
        "outcome",
    )
    return Table("real", columns, tuple(rows))
