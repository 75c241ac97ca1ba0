"""The report of a study of methods against false loop closures."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from masat.arrays import Floats
from masat.study.closure_trial import ClosureTrial
from masat.study.design import Design
from masat.study.names import Sigma, number_name, sigma_name
from masat.study.report.document import Block, Heading, Paragraph, Table
from masat.study.report.figures import rate_figure, time_figure
from masat.study.report.glossary import spoken_world
from masat.study.report.tables import FAILED
from masat.study.scores import Scores
from masat.study.statistics import wilson

_AXIS = "fraction of false loop closures"


@dataclass
class SpoiledCell:
    """The trials of one graph with one kind and fraction of false loop closures, by method."""

    world: str
    sigma: Sigma
    kind: str
    fraction: float
    trials: dict[str, list[ClosureTrial]] = field(default_factory=dict)

    @property
    def row(self) -> tuple[str, str, str, str]:
        """The first cells of its row in a table."""
        noise = f"({sigma_name(self.sigma)})" if self.sigma else "-"
        return self.world, noise, self.kind, number_name(self.fraction)

    @property
    def panel(self) -> str:
        """Title of the panel of a figure."""
        world, noise, kind, _ = self.row
        return f"{spoken_world(world)}\n{'' if noise == '-' else f'noise {noise}, '}{kind}"

    @property
    def level(self) -> str:
        """Mark on the axis of a figure."""
        return number_name(self.fraction)

    def rate(self, method: str) -> tuple[int, int]:
        """Return (successes, trials) of a method; a failed run is no success."""
        trials = self.trials.get(method, [])
        return sum(t.succeeded for t in trials), len(trials)

    def failed(self, method: str) -> bool:
        """Return whether there are runs of a method and all of them failed."""
        trials = self.trials.get(method, [])
        return len(trials) > 0 and all(t.error for t in trials)

    def seconds(self, method: str) -> Floats:
        """Return the times of the runs of a method that did not fail."""
        return np.array([t.seconds for t in self.trials.get(method, []) if not t.error])

    def scores(self, method: str) -> list[Scores]:
        """Return the scores of the runs of a method that did not fail."""
        return [t.scores for t in self.trials.get(method, []) if t.scores is not None]


def closure_blocks(design: Design, trials: list[ClosureTrial], folder: Path) -> Iterable[Block]:
    """Return what the report of a study of false loop closures has below its summary.

    Parameters
    ----------
    design : Design
        The design of the study.
    trials : list of ClosureTrial
        In the order of the design.
    folder : Path
        Where the figure is written.
    """
    cells, methods = _cells_of(trials), design.methods
    if not cells:
        return
    yield Paragraph(
        "How to read the tables: the clean map is that of the true edges alone. 'fraction' is that "
        "of the false among all loop closures. A dash means that there is no number; 'failed' "
        "means that all runs ended in an error."
    )
    by_fraction = sorted(cells, key=lambda cell: cell.fraction)
    yield Heading("Success rate")
    yield Paragraph(
        "A run succeeds if the chi2 of odometry and that of the true loop closures, each counted "
        "up to the 99.9 % quantile of an honest measurement, is at most 1.05 of the same sum in "
        "the clean map. In brackets: the 95 % Wilson interval of the rate."
    )
    yield _table("success", cells, methods, lambda cell, m: _rate(*cell.rate(m)))
    yield rate_figure(
        by_fraction,
        methods,
        folder / "rates.svg",
        f"{design.title or 'Methods'}: success rates over the fraction of false loop closures. "
        "Bars are 95 % Wilson intervals.",
        _AXIS,
    )
    for title, name, meaning, text in _SECTIONS:
        yield Heading(title)
        yield Paragraph(meaning)
        yield _table(name, cells, methods, text)
    yield time_figure(
        by_fraction,
        methods,
        SpoiledCell.seconds,
        folder / "times.svg",
        f"{design.title or 'Methods'}: times over the fraction of false loop closures. Markers are "
        "medians, bars 5 and 95 % of the runs.",
        axis=_AXIS,
        label="time [s]",
    )


def _cells_of(trials: list[ClosureTrial]) -> list[SpoiledCell]:
    """Sort the trials into cells, in the order of their first trials."""
    cells: dict[tuple[str, Sigma, str, float], SpoiledCell] = {}
    for trial in trials:
        case = trial.case
        key = (case.world, case.sigma, case.kind, case.fraction)
        cell = cells.setdefault(key, SpoiledCell(*key))
        cell.trials.setdefault(trial.method, []).append(trial)
    return list(cells.values())


def _table(
    name: str,
    cells: list[SpoiledCell],
    methods: tuple[str, ...],
    text: Callable[[SpoiledCell, str], str],
) -> Table:
    rows = tuple(
        (*cell.row, *(FAILED if cell.failed(m) else text(cell, m) for m in methods))
        for cell in cells
    )
    return Table(name, ("graph", "noise", "kind", "fraction", *methods), rows)


def _rate(successes: int, trials: int) -> str:
    if trials == 0:
        return "-"
    low, high = wilson(successes, trials)
    return f"{successes / trials:.2f} [{low:.2f}, {high:.2f}]"


def _strict_rate(cell: SpoiledCell, method: str) -> str:
    successes = sum(scores.strict_success for scores in cell.scores(method))
    return _rate(successes, len(cell.trials.get(method, [])))


def _precision(cell: SpoiledCell, method: str) -> str:
    true = sum(scores.true_kept for scores in cell.scores(method))
    false = sum(scores.false_kept for scores in cell.scores(method))
    return f"{true / (true + false):.4f} ({false})" if true + false else "-"


def _recall(cell: SpoiledCell, method: str) -> str:
    kept = sum(scores.true_kept for scores in cell.scores(method))
    true = sum(scores.true_closures for scores in cell.scores(method))
    return f"{kept / true:.3f}" if true else "-"


def _error(cell: SpoiledCell, method: str) -> str:
    errors = [scores.rmse for scores in cell.scores(method)]
    return f"{np.median(errors):.3g} / {max(errors):.3g}" if errors else "-"


def _time(cell: SpoiledCell, method: str) -> str:
    finished = [t for t in cell.trials.get(method, []) if not t.error]
    times = [(t.seconds, t.seconds / t.plain_seconds) for t in finished]
    if not times:
        return "-"
    seconds, units = np.median(times, axis=0)
    return f"{seconds:.3g} / {units:.3g}"


_SECTIONS = (
    (
        "Strict success rate",
        "strict_success",
        "The same, where the whole chi2 of the true edges is at most 1.05 of that of the clean "
        "map.",
        _strict_rate,
    ),
    (
        "Precision",
        "precision",
        "Of the loop closures that the runs of a cell kept, the fraction that is true, and in "
        "brackets the number of the false ones. `plain` keeps all.",
        _precision,
    ),
    ("Recall", "recall", "Of the true loop closures, the fraction that was kept.", _recall),
    (
        "Error",
        "error",
        "Root mean square distance of the positions from those of the clean map in meters, after "
        "the best rigid alignment: median and, after the slash, the largest of the runs.",
        _error,
    ),
    (
        "Time",
        "time",
        "Median time of a run in seconds and, after the slash, in units of a plain solve of the "
        "clean graph from `auto`.",
        _time,
    ),
)
"""Title, name of the table, meaning and text of a cell of each section after the success rate."""
