"""Figures of success rates and times."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

import numpy as np

from masat.study.report.cells import Cell
from masat.study.report.document import Figure
from masat.study.statistics import wilson

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

_COLUMNS = 3
_MARKERS = "osD^v"


class RateCell(Protocol):
    """A cell of a study: a point on the axis of a panel, with success rates by column."""

    @property
    def panel(self) -> str:
        """Title of the panel."""

    @property
    def level(self) -> str:
        """Mark on the axis."""

    def rate(self, column: str) -> tuple[int, int]:
        """Return (successes, trials)."""

    def failed(self, column: str) -> bool:
        """Return whether there are trials and all of them failed."""


def rate_figure(
    cells: Sequence[RateCell], columns: tuple[str, ...], path: Path, caption: str
) -> Figure:
    """Draw the success rates of what is compared over the levels, with 95 % intervals."""
    canvas, panels = _panels(cells)
    labeled: dict[str, Any] = {}
    for ax, mine in panels:
        for i, column in enumerate(columns):
            rates = [(k, *c.rate(column)) for k, c in enumerate(mine) if not c.failed(column)]
            drawn = np.array([(k, s / n, *wilson(s, n)) for k, s, n in rates if n])
            if len(drawn) == 0:
                continue
            k, middle, low, high = drawn.T
            labeled[column] = ax.errorbar(
                k + 0.8 / len(columns) * (i - (len(columns) - 1) / 2),
                middle,
                [np.maximum(middle - low, 0), np.maximum(high - middle, 0)],
                fmt=_MARKERS[i // 10 % len(_MARKERS)],
                color=f"C{i % 10}",
                markersize=4,
                capsize=2,
            )
        ax.set_xticks(range(len(mine)), [c.level for c in mine], rotation=45, ha="right")
        ax.set_ylim(-0.03, 1.03)
        ax.set_ylabel("success rate")
    canvas.legend(
        list(labeled.values()),
        [column.replace("_", " ") for column in labeled],
        loc="outside upper center",
        ncols=min(4, max(1, len(labeled))),
    )
    canvas.savefig(path, dpi=110)
    return Figure(path, caption)


_AnyCell = TypeVar("_AnyCell", bound=RateCell)


def time_figure(cells: list[Cell], init: str, path: Path) -> Figure:
    """Draw the time of an initial guess over the noise levels, with its spread."""
    canvas, panels = _panels(cells)
    for ax, mine in panels:
        drawn = [(k, t) for k, c in enumerate(mine) if len(t := c.init_ms(init))]
        if drawn:
            at = [k for k, _ in drawn]
            ax.boxplot([t for _, t in drawn], positions=at, showfliers=False, whis=(5, 95))
        ax.set_xticks(range(len(mine)), [c.level for c in mine], rotation=45, ha="right")
        ax.set_xlim(-0.6, len(mine) - 0.4)
        ax.set_ylim(bottom=0)
        ax.set_ylabel(f"time of {init.replace('_', ' ')} [ms]")
    canvas.savefig(path, dpi=110)
    return Figure(
        path,
        f"Time of the initial guess {init} over the noise levels. Line: median; box: quartiles; "
        "whiskers: 5 and 95 % of all instances.",
    )


def _panels(cells: Sequence[_AnyCell]) -> tuple[Canvas, list[tuple[Any, list[_AnyCell]]]]:
    """Return a figure with its panels, and the cells of each."""
    from matplotlib.figure import Figure as Canvas

    titles = list(dict.fromkeys(c.panel for c in cells))
    columns = min(_COLUMNS, len(titles))
    rows = -(-len(titles) // columns)
    canvas = Canvas(figsize=(5 * columns, 4 * rows), layout="constrained")
    panels = []
    for k, title in enumerate(titles, 1):
        ax = canvas.add_subplot(rows, columns, k)
        ax.set_title(title)
        panels.append((ax, [c for c in cells if c.panel == title]))
    return canvas, panels
