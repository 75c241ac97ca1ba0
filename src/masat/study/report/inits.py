"""The report of a study of initial guesses."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from masat.study.design import Design
from masat.study.report.cells import Cell, cells_of
from masat.study.report.document import Block, Heading, Paragraph
from masat.study.report.figures import rate_figure, time_figure
from masat.study.report.minima import control_table, minima_table, total_table
from masat.study.report.paper import agreement, published
from masat.study.report.paper_figures import paper_figures
from masat.study.report.tables import (
    iterations_table,
    mcnemar_table,
    real_table,
    success_table,
    time_table,
)
from masat.study.trial import Trial
from masat.study.worlds import GROUND_TRUTH, dimension_of

_LEVELS = {
    2: "(x, y, theta) in 2D",
    3: "(translation, rotation) or (x, y, z, and the rotation about x, y and z) in 3D",
}


def init_blocks(design: Design, trials: list[Trial], folder: Path) -> Iterable[Block]:
    """Return what the report of a study of initial guesses has below its summary.

    Parameters
    ----------
    design : Design
        The design of the study.
    trials : list of Trial
        In the order of the design.
    folder : Path
        Where the figures are written.
    """
    cells = cells_of(trials)
    if cells:
        yield Paragraph(_legend(design))
        yield from _noisy_blocks(design, cells, folder)
    if any(not t.case.sigma for t in trials):
        yield Heading("Real graphs")
        yield Paragraph(
            "Each real graph was solved once from each initial guess. A run has converged when "
            "an iteration changes chi2 by less than 1e-6, relative where chi2 is above 1; the "
            "table gives that iteration, and otherwise the lowest chi2 within the limit. "
            "Times are in milliseconds (ms)."
        )
        yield real_table(trials)


def _legend(design: Design) -> str:
    dimensions = sorted({dimension_of(world) for world in design.worlds})
    levels = " and ".join(_LEVELS[d] for d in dimensions)
    return (
        f"How to read the tables: noise is the standard deviations {levels}, in meters and "
        "radians. A column named after an initial guess has the runs from it. A dash means that "
        "there is no number, for lack of runs or of successes; 'failed' means that all runs ended "
        "in an error."
    )


def _noisy_blocks(design: Design, cells: list[Cell], folder: Path) -> Iterable[Block]:
    inits, paper = design.inits, published(design)
    reference = _reference(inits)
    compared = tuple(i for i in inits if i != reference)
    beside = bool(paper.inits(cells, inits))
    yield Heading("Success rate, relative threshold" + (" (the paper's Table 1)" if beside else ""))
    yield Paragraph(
        "A run succeeds if, within the limit of the iterations, 0 <= (before - after) / after < "
        "1e-6 for the chi2 before and after an iteration: the test of g2o. In brackets: the 95 % "
        "Wilson interval of the rate."
        + (" A star marks a rate of the paper outside our interval." if beside else "")
    )
    yield success_table(cells, inits, paper, relative=True)
    if "masat" in inits:
        yield from agreement(cells, "masat", paper)
    yield rate_figure(
        cells,
        inits,
        folder / "rates.svg",
        f"{design.title or 'Initial guesses'}: success rates by the relative threshold over the "
        "noise levels. Bars are 95 % Wilson intervals.",
        _axis(design),
    )
    yield Heading("Success rate, absolute threshold")
    yield Paragraph("A run succeeds if an iteration changes chi2 by less than 1e-6.")
    yield success_table(cells, inits, paper, relative=False)
    yield Heading("Iterations and reduced chi2" + (" (the paper's Table 2)" if beside else ""))
    yield Paragraph(
        "Means over the successes by the relative threshold: iterations / reduced chi2. Reduced "
        "chi2 is chi2 divided by the degrees of freedom, 3 (edges - nodes + 1) in 2D and twice "
        "that in 3D. It is about 1 at the best minimum; more than from the ground truth shows a "
        "local minimum."
    )
    yield iterations_table(cells, inits, paper)
    if compared:
        yield Heading(f"Each initial guess against {reference}")
        yield Paragraph(
            f"In a column 'a : {reference}', on the same instances: how many only a solves : how "
            f"many only {reference} solves, and p, the p-value of McNemar's exact test that both "
            "succeed equally often."
        )
        yield mcnemar_table(cells, compared, reference)
    yield Heading("Which minimum is reached")
    yield Paragraph(
        "The fraction of all instances for which an initial guess leads to the lowest chi2 that "
        "any initial guess of the instance reached, up to a fraction of 1e-6 of it."
    )
    yield minima_table(cells, inits)
    others = tuple(i for i in inits if i != GROUND_TRUTH)
    if GROUND_TRUTH in inits and others:
        yield Paragraph(
            "How many successes end above the chi2 that Gauss-Newton reaches from the ground "
            "truth, and, after the comma, by what fraction of it at most."
        )
        yield control_table(cells, others, GROUND_TRUTH)
    yield Heading("Time")
    yield Paragraph(
        "Medians over the runs of a world, of the initial guess and of Gauss-Newton up to the "
        "absolute threshold, in milliseconds (ms); the mean of an iteration; the sum over all runs "
        "in seconds (s)."
    )
    yield time_table(cells, inits)
    if compared:
        yield Paragraph(
            f"Median total time, initial guess and Gauss-Newton up to the relative threshold, "
            f"divided by that of {reference}, on the instances where both succeed; 'success of "
            f"{reference}' is its success rate."
        )
        yield total_table(cells, compared, reference)
    yield time_figure(
        cells,
        others or inits,
        Cell.init_ms,
        folder / "times.svg",
        f"{design.title or 'Initial guesses'}: times of the initial guesses over the noise levels. "
        "Markers are medians, bars 5 and 95 % of all instances.",
        axis=_axis(design),
        label="initial guess [ms]",
    )
    figures = paper_figures(cells, inits, paper, folder, design.max_iterations)
    if figures:
        yield Heading("The paper's figures")
        yield from figures


def _axis(design: Design) -> str:
    if {dimension_of(world) for world in design.worlds} == {2}:
        return "noise of x, y [m] and theta [rad]"
    return "noise [m, rad]"


def _reference(inits: tuple[str, ...]) -> str:
    """Return the initial guess that the others are compared with."""
    if "masat" in inits:
        return "masat"
    return next((i for i in inits if i != GROUND_TRUTH), inits[0])
