"""What the MASAT paper published, and whether a study can be compared with it."""

from __future__ import annotations

import csv
from dataclasses import dataclass, field
from importlib import resources
from typing import TypeAlias

from masat.study.design import Design
from masat.study.names import Sigma
from masat.study.report.cells import Cell
from masat.study.report.document import Block, Heading, Paragraph, Table
from masat.study.statistics import fisher, wilson

PAPER_INSTANCES = 50
PAPER_ITERATIONS = 50

_Rows: TypeAlias = dict[tuple[str, Sigma], dict[str, str]]


@dataclass(frozen=True)
class Published:
    """The paper's tables by world and noise level; empty where no comparison is possible.

    Attributes
    ----------
    rates : dict
        Table 1: success rates by initial guess.
    means : dict
        Table 2: mean iterations and mean reduced chi2 of the successes.
    """

    rates: _Rows = field(default_factory=dict)
    means: _Rows = field(default_factory=dict)

    def inits(self, cells: list[Cell], inits: tuple[str, ...]) -> set[str]:
        """Return the initial guesses of which the paper has figures in any of the cells."""
        rows = [self.rates.get((cell.world, cell.sigma), {}) for cell in cells]
        return {init for init in inits if any(init in row for row in rows)}


def published(design: Design) -> Published:
    """Return the paper's tables if a design runs as many instances and iterations as the paper.

    More instances than the paper's 50 are fine; other limits of the iterations have other success
    rates.
    """
    if design.instances < PAPER_INSTANCES or design.max_iterations != PAPER_ITERATIONS:
        return Published()
    return Published(_table(1), _table(2))


def agreement(cells: list[Cell], init: str, paper: Published) -> list[Block]:
    """Compare the success rates of an initial guess with the paper's where it has some."""
    table = agreement_table(cells, init, paper)
    if not table.rows:
        return []
    missed = outside(cells, init, paper)
    total = len(table.rows)
    differ = sum(row[-1].endswith("*") for row in table.rows)
    text = (
        f"The paper's success rate of {init} lies in our 95 % Wilson interval in "
        f"{total - len(missed)} of {total} cells"
    )
    text += ": all but " + "; ".join(missed) + ". " if missed else ". "
    text += (
        f"The paper's rate is a sample of {PAPER_INSTANCES} instances as well: our interval holds "
        "it less often than in 95 % of the cells even if the true rates agree, and can never hold "
        "a rate of 1 where one of our runs fails. Fisher's exact test compares the two samples. "
        f"It finds a difference at the level of 5 % in {differ} of {total} cells: a star beside "
        "the p-value."
    )
    return [Heading("Agreement with the paper"), Paragraph(text), table]


def agreement_table(cells: list[Cell], init: str, paper: Published) -> Table:
    """Return for each cell our rate and the paper's, and whether the two samples differ."""
    rows = []
    for cell in cells:
        theirs = paper.rates.get((cell.world, cell.sigma), {})
        k, n = cell.rate(init)
        if init not in theirs or n == 0:
            continue
        low, high = wilson(k, n)
        rate = float(theirs[init])
        p = fisher(k, n, round(PAPER_INSTANCES * rate), PAPER_INSTANCES)
        rows.append(
            (
                cell.world,
                cell.level,
                f"{k / n:.3f}",
                f"[{low:.3f}, {high:.3f}]",
                theirs[init],
                "yes" if low <= rate <= high else "no",
                f"{p:.2g}" + (" *" if p < 0.05 else ""),
            )
        )
    columns = ("world", "noise", init, "95 % interval", "paper", "in interval", "Fisher's p-value")
    return Table("agreement", columns, tuple(rows))


def outside(cells: list[Cell], init: str, paper: Published) -> list[str]:
    """Return the cells in which the paper's rate lies outside our interval, with both."""
    found = []
    for cell in cells:
        theirs = paper.rates.get((cell.world, cell.sigma), {})
        k, n = cell.rate(init)
        low, high = wilson(k, n)
        if init in theirs and n and not low <= float(theirs[init]) <= high:
            found.append(
                f"{cell.world} {cell.level}: {k / n:.2f} in [{low:.2f}, {high:.2f}], paper "
                f"{theirs[init]}"
            )
    return found


def _table(number: int) -> _Rows:
    file = resources.files("masat.study") / "paper" / f"table{number}.csv"
    return {
        (
            row["dataset"],
            (float(row["sigma_x"]), float(row["sigma_y"]), float(row["sigma_theta"])),
        ): row
        for row in csv.DictReader(file.read_text("utf-8").splitlines())
    }
