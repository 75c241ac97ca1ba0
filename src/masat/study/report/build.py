"""Putting the report together."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from masat.files import write_atomically
from masat.study.cases import AnyTrial
from masat.study.closure_trial import ClosureTrial
from masat.study.design import Design
from masat.study.names import StudyError
from masat.study.report.document import Block, Heading, Paragraph, Table, markdown, page
from masat.study.report.false_closures import closure_blocks
from masat.study.report.inits import init_blocks
from masat.study.store import Store
from masat.study.trial import Trial


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
        The files written: report.md, report.html, and the tables.

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
        blocks += closure_blocks(design, [t for t in trials if isinstance(t, ClosureTrial)], folder)
    else:
        blocks += init_blocks(design, [t for t in trials if isinstance(t, Trial)], folder)
    written = [folder / f"{b.name}.csv" for b in blocks if isinstance(b, Table)]
    for block in blocks:
        if isinstance(block, Table):
            write_atomically(folder / f"{block.name}.csv", block.csv())
    write_atomically(folder / "report.md", markdown(blocks).encode())
    write_atomically(folder / "report.html", page(blocks).encode())
    return [folder / "report.md", folder / "report.html", *written]


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
