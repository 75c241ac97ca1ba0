"""Putting the report together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from masat.files import write_atomically
from masat.study.cases import AnyTrial
from masat.study.closure_trial import ClosureTrial
from masat.study.design import Design
from masat.study.names import StudyError
from masat.study.report.document import Block, Heading, Paragraph, Table, markdown, page
from masat.study.report.false_closures import closure_blocks
from masat.study.report.glossary import glossary
from masat.study.report.inits import init_blocks
from masat.study.report.latex import captions
from masat.study.report.latex import latex as as_latex
from masat.study.report.views import closure_views, init_views
from masat.study.store import Store
from masat.study.trial import Trial
from masat.viewing.explorer import inline_page


@dataclass(frozen=True, repr=False)
class Report:
    """The report of a study, which Jupyter displays.

    Attributes
    ----------
    files : tuple of Path
        The files written: report.md, report.html, and the tables.
    tables : dict of str to Table
        The tables by name; Jupyter displays each.
    html : str
        The whole report as one page.
    """

    files: tuple[Path, ...]
    tables: dict[str, Table]
    html: str

    def __repr__(self) -> str:
        return f"Report({self.files[0]}, {len(self.tables)} tables)"

    def _repr_html_(self) -> str:
        return inline_page(self.html)


def build_report(store: Store, folder: Path, *, latex: bool = False, views: bool = False) -> Report:
    """Write the report of a study: report.md, report.html, tables as CSV, figures as SVG and PDF.

    Pictures of maps, which have many lines, are PNG instead of SVG.

    Parameters
    ----------
    store : Store
        The study; it need not be finished.
    folder : Path
        Made if it does not exist.
    latex : bool
        Whether to write the tables for LaTeX, too.
    views : bool
        Whether to solve one instance of each world again, and to embed the interactive view of it.

    Returns
    -------
    Report

    Raises
    ------
    StudyError
        If the store is damaged, or the folder cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StudyError(f"{folder}: cannot be made: {error.strerror or error}") from None
    design, trials = store.design, list(store.trials())
    order = {case: k for k, case in enumerate(design.cases())}
    columns = {column: k for k, column in enumerate(design.columns)}
    trials = [t for t in trials if t.case in order and t.column in columns]
    trials.sort(key=lambda t: (order[t.case], columns[t.column]))
    subject = "methods against false loop closures" if design.methods else "initial guesses"
    blocks: list[Block] = [
        Heading(design.title or f"A study of {subject}", 1),
        Paragraph(_summary(design, trials)),
    ]
    if design.methods:
        of_closures = [t for t in trials if isinstance(t, ClosureTrial)]
        blocks += closure_blocks(design, of_closures, folder)
        blocks += closure_views(design, of_closures, folder) if views else ()
    else:
        of_inits = [t for t in trials if isinstance(t, Trial)]
        blocks += init_blocks(design, of_inits, folder)
        blocks += init_views(design, of_inits, folder) if views else ()
    if trials:
        blocks += glossary(design.columns, blocks)
    texts = {"report.md": markdown(blocks), "report.html": page(blocks)}
    for table, caption in captions(blocks, design.title):
        texts[f"{table.name}.csv"] = table.csv()
        if latex:
            texts[f"{table.name}.tex"] = as_latex(table, caption)
    for name, text in texts.items():
        write_atomically(folder / name, text.encode())
    tables = {block.name: block for block in blocks if isinstance(block, Table)}
    return Report(tuple(folder / name for name in texts), tables, texts["report.html"])


def _summary(design: Design, trials: Sequence[AnyTrial]) -> str:
    what = "a method" if design.methods else "Gauss-Newton"
    text = (
        f"{len(trials)} of {design.runs()} runs of {what} with at most "
        f"{design.max_iterations} iterations."
    )
    if design.worlds:
        text += (
            f" Worlds: {', '.join(design.worlds)}, with {len(design.sigmas)} noise levels and "
            f"{design.instances} noisy instances of each world at each of its levels."
        )
    if design.graphs:
        text += f" Real graphs: {', '.join(design.graphs)}."
    if design.methods:
        text += (
            f" False loop closures: {', '.join(design.kinds)}; as fractions of all loop closures: "
            f"{', '.join(f'{fraction:g}' for fraction in design.fractions)}; drawn "
            f"{design.instances} times each."
        )
    errors = [f"{t.case.name}/{t.column}: {t.error}" for t in trials if t.error]
    if errors:
        text += f" {len(errors)} runs failed, the first for this reason: {errors[0]}"
    return text
