"""Putting the report together."""

from __future__ import annotations

from pathlib import Path

from masat.files import write_atomically
from masat.study.report.cells import Cell, cells_of
from masat.study.report.document import Block, Heading, Paragraph, Table, markdown, page
from masat.study.report.figures import rate_figure, time_figure, world_figures
from masat.study.report.minima import control_table, minima_table, total_table
from masat.study.report.tables import (
    iterations_table,
    mcnemar_table,
    outside,
    paper_table_test,
    real_table,
    success_table,
    time_table,
)
from masat.study.store import Store
from masat.study.worlds import GROUND_TRUTH

_COMPARED = "masat"


def build_report(store: Store, folder: Path) -> list[Path]:
    """Write the report of a study: report.md, report.html, tables as CSV, figures as PNG.

    Parameters
    ----------
    store : Store
        The study; it need not be finished.
    folder : Path
        Made if it does not exist.

    Returns
    -------
    list of Path
        The files written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    design, trials = store.design, list(store.trials())
    order = {case: k for k, case in enumerate(design.cases())}
    trials.sort(key=lambda t: (order.get(t.case, len(order)), design.starts.index(t.start)))
    cells = cells_of(trials)
    starts = design.starts
    blocks: list[Block] = [
        Heading("The evaluation of MASAT", 1),
        Paragraph(_summary(store, len(trials), [t.error for t in trials if t.error])),
    ]
    if cells:
        blocks += [
            Heading("Table 1: success rate, relative threshold"),
            Paragraph(
                "Success: within the limit of the iterations, 0 <= (before - after) / after < 1e-6 "
                "of chi2, as g2o tests it. In brackets the 95 % Wilson interval; a star marks a "
                "paper's rate outside it."
            ),
            success_table(cells, starts, relative=True),
            *_agreement(cells),
            rate_figure(cells, starts, folder / "rates.png"),
            Heading("Table 1 again, absolute threshold"),
            Paragraph("Success: chi2 changes by less than 1e-6."),
            success_table(cells, starts, relative=False),
            Heading("Table 2: iterations and reduced chi2"),
            Paragraph(
                "Means over the successes by the relative threshold; reduced chi2 is chi2 over "
                "3 (edges - nodes + 1). Above the control's it shows a local minimum."
            ),
            iterations_table(cells, starts),
        ]
        others = tuple(s for s in starts if s != _COMPARED)
        if _COMPARED in starts and others:
            blocks += [
                Heading(f"Each start against {_COMPARED}"),
                Paragraph(
                    "The same instances: how many only the one and only the other solves, and the "
                    "p-value of McNemar's exact test."
                ),
                mcnemar_table(cells, others, _COMPARED),
            ]
        blocks += [
            Heading("Where they end"),
            Paragraph(
                "The share of all instances from which a start leads to the lowest chi2 that any "
                "start of the instance reached, to 1e-6 of it."
            ),
            minima_table(cells, starts),
        ]
        if GROUND_TRUTH in starts:
            blocks += [
                Paragraph(
                    "How many successes end above the chi2 that Gauss-Newton reaches from the "
                    "truth, and by what share of it at most."
                ),
                control_table(cells, tuple(s for s in starts if s != GROUND_TRUTH), GROUND_TRUTH),
            ]
        blocks += [Heading("Time"), time_table(cells, starts)]
        if _COMPARED in starts and others:
            blocks += [
                Paragraph(
                    f"Median total time, start and Gauss-Newton, over {_COMPARED}'s, on the "
                    "instances where both succeed."
                ),
                total_table(cells, others, _COMPARED),
            ]
        if _COMPARED in starts:
            blocks.append(time_figure(cells, _COMPARED, folder / "times.png"))
        figures = world_figures(cells, folder, design.max_iterations)
        if figures:
            blocks += [Heading("Figures"), *figures]
    if design.graphs:
        blocks += [Heading("Real graphs"), real_table(trials)]
    written = [folder / f"{b.name}.csv" for b in blocks if isinstance(b, Table)]
    for block in blocks:
        if isinstance(block, Table):
            write_atomically(folder / f"{block.name}.csv", block.csv())
    write_atomically(folder / "report.md", markdown(blocks).encode())
    write_atomically(folder / "report.html", page(blocks).encode())
    return [folder / "report.md", folder / "report.html", *written]


def _summary(store: Store, count: int, errors: list[str]) -> str:
    design = store.design
    wanted = sum(len(design.starts_of(case)) for case in design.cases())
    text = (
        f"{count} of {wanted} runs: {', '.join(design.worlds + design.graphs)}; "
        f"{len(design.sigmas)} noise levels, {design.instances} instances each, Gauss-Newton with "
        f"at most {design.max_iterations} iterations."
    )
    if errors:
        text += f" {len(errors)} runs failed, the first for this reason: {errors[0]}"
    return text


def _agreement(cells: list[Cell]) -> list[Block]:
    """Compare the rates of MASAT with the paper's, if the cells are the paper's."""
    table = paper_table_test(cells, _COMPARED)
    if not table.rows:
        return []
    missed = outside(cells, _COMPARED)
    held = len(table.rows) - len(missed)
    differ = sum(row[-1].endswith("*") for row in table.rows)
    total = len(table.rows)
    text = f"The paper's rate of {_COMPARED} lies in our interval in {held} of {total} cells"
    text += ": all but " + "; ".join(missed) + ". " if missed else ". "
    text += (
        "The paper's rate is a sample of 50 as well: our interval holds it less often than in 95 % "
        "of the cells even if the true rates agree, and can never hold a rate of 1 where one of "
        "our runs fails. Fisher's exact test of the two samples finds a difference at the level of "
        f"5 % in {differ} of {total} cells."
    )
    return [Heading("Agreement with the paper"), Paragraph(text), table]
