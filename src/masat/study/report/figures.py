"""Figures of success rates and times, as vectors that a paper can take."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

import numpy as np

from masat.arrays import Floats
from masat.files import write_atomically
from masat.study.report.document import Figure
from masat.study.report.glossary import spoken
from masat.study.statistics import wilson

if TYPE_CHECKING:
    from masat.plotting.picture import Picture

_COLUMNS = 3
# Inches: three panels fill a page of 7.2 inches, at which text of 7 points is printed as it is.
_PANEL_WIDTH, _PANEL_HEIGHT = 2.4, 2.2
_STYLE: dict[Any, Any] = {
    "font.size": 7,
    "axes.titlesize": 7,
    "legend.fontsize": 7,
    "axes.linewidth": 0.6,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "lines.linewidth": 0.8,
}
# The colors of Okabe and Ito, without yellow, which is faint on paper; and a marker for each of
# what is compared, so that the figures can be read without colors. The lengths have no common
# divisor: no two of 77 look alike.
_COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#000000", "#56b4e9", "#e69f00")
_MARKERS = ("o", "s", "^", "D", "v", "P", "X", "<", ">", "p", "*")
_WHISKERS = (5, 50, 95)  # percent


class RateCell(Protocol):
    """A cell of a study: a point on the axis of a panel, with runs by column."""

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


_AnyCell = TypeVar("_AnyCell", bound=RateCell)


def rate_figure(
    cells: Sequence[RateCell], columns: tuple[str, ...], path: Path, caption: str, axis: str
) -> Figure:
    """Draw the success rates of what is compared over the levels, with 95 % intervals.

    Parameters
    ----------
    cells : sequence of RateCell
        The cells, in the order of the levels.
    columns : tuple of str
        What is compared.
    path : Path
        The SVG file; a PDF is written beside it.
    caption : str
        Text below the figure.
    axis : str
        What the levels are.
    """

    def values(cell: RateCell, column: str) -> Floats | None:
        s, n = cell.rate(column)
        if n == 0 or cell.failed(column):
            return None
        low, high = wilson(s, n)
        return np.array([low, s / n, high])

    canvas, panels = _drawn(cells, columns, values, axis)
    for ax in panels:
        ax.set_ylim(-0.03, 1.03)
        ax.set_ylabel("success rate")
    return _written(canvas, path, caption)


def time_figure(
    cells: Sequence[_AnyCell],
    columns: tuple[str, ...],
    times: Callable[[_AnyCell, str], Floats],
    path: Path,
    caption: str,
    *,
    axis: str,
    label: str,
) -> Figure:
    """Draw times over the levels on a logarithmic axis: medians, and 5 and 95 % of the runs.

    Parameters
    ----------
    times : callable
        Returns the times of a cell and a column.
    label : str
        Name and unit of the times.
    cells, columns, path, caption, axis
        As of `rate_figure`.
    """

    def values(cell: _AnyCell, column: str) -> Floats | None:
        found = times(cell, column)
        found = found[found > 0]  # zero has no logarithm
        return np.percentile(found, _WHISKERS) if len(found) else None

    canvas, panels = _drawn(cells, columns, values, axis)
    for ax in panels:
        ax.set_yscale("log")
        ax.set_ylabel(label)
        ax.grid(axis="y", which="major", linewidth=0.3, color="0.85")
    # Panels with the same scale can be compared.
    limits = np.array([ax.get_ylim() for ax in panels])
    for ax in panels:
        ax.set_ylim(limits[:, 0].min(), limits[:, 1].max())
    return _written(canvas, path, caption)


def _drawn(
    cells: Sequence[_AnyCell],
    columns: tuple[str, ...],
    values: Callable[[_AnyCell, str], Floats | None],
    axis: str,
) -> tuple[Picture, list[Any]]:
    """Draw low, middle and high of each column over the levels, a panel for each title."""
    from matplotlib import rc_context

    from masat.plotting.picture import Picture

    titles = list(dict.fromkeys(c.panel for c in cells))
    across = min(_COLUMNS, len(titles))
    down = -(-len(titles) // across)
    labeled: dict[str, Any] = {}
    with rc_context(_STYLE):
        size = (_PANEL_WIDTH * across, _PANEL_HEIGHT * down + 0.5)
        canvas = Picture(figsize=size, layout="constrained")
        panels = []
        for k, title in enumerate(titles, 1):
            ax = canvas.add_subplot(down, across, k)
            mine = [c for c in cells if c.panel == title]
            for i, column in enumerate(columns):
                found = [
                    (at, v) for at, c in enumerate(mine) if (v := values(c, column)) is not None
                ]
                if found:
                    labeled[column] = _bars(ax, found, i, len(columns))
            ax.set_title(title, parse_math=False)
            ax.set_xticks(range(len(mine)), [c.level for c in mine], rotation=45, ha="right")
            ax.set_xlim(-0.6, len(mine) - 0.4)
            ax.set_xlabel(axis)
            panels.append(ax)
        canvas.legend(
            list(labeled.values()),
            [spoken(column) for column in labeled],
            loc="outside upper center",
            ncols=min(2 * across, max(1, len(labeled))),
            frameon=False,
        )
    return canvas, panels


def _bars(ax: Any, found: Sequence[tuple[int, Floats]], i: int, count: int) -> Any:
    """Draw a column of the figure: side by side with the others at each level."""
    at = np.array([k for k, _ in found])
    low, middle, high = np.array([v for _, v in found]).T
    color = _COLORS[i % len(_COLORS)]
    return ax.errorbar(
        at + 0.8 / count * (i - (count - 1) / 2),
        middle,
        [np.maximum(middle - low, 0), np.maximum(high - middle, 0)],
        fmt=_MARKERS[i % len(_MARKERS)],
        color=color,
        # Every other one is hollow: markers next to each other differ at a glance.
        markerfacecolor=color if i % 2 == 0 else "white",
        markersize=3,
        markeredgewidth=0.7,
        elinewidth=0.6,
        capsize=1.2,
        capthick=0.6,
    )


def _written(canvas: Picture, path: Path, caption: str) -> Figure:
    for suffix in (".pdf", path.suffix):
        write_atomically(path.with_suffix(suffix), canvas.encode(suffix[1:]))
    return Figure(path, caption)
