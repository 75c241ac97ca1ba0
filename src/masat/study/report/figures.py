"""The paper's figures, drawn again from the seeds of the stored runs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from masat.graph import PoseGraph
from masat.plotting import plot
from masat.study.names import Case, Sigma
from masat.study.report.cells import Cell
from masat.study.report.document import Figure
from masat.study.trial import guess_of, instance, solve
from masat.study.worlds import GROUND_TRUTH

_LEVEL = (0.2, 0.2, 0.2)


def world_figures(cells: list[Cell], folder: Path, limit: int) -> list[Figure]:
    """Draw figures 1 to 6 of the paper, those whose cells the study holds.

    `limit` is that of the iterations.
    """
    by_name = {(c.world, c.sigma): c for c in cells}
    figures = []

    def draw(number: int, panels: dict[str, PoseGraph], caption: str, columns: int) -> None:
        path = folder / f"figure{number}.png"
        plot(panels, path, columns=columns, dpi=80 if columns < 4 else 60)
        figures.append(Figure(path, f"Figure {number}. {caption}"))

    def results(case: Case, starts: tuple[str, ...], title: str = "") -> dict[str, PoseGraph]:
        graph = instance(case)
        solved = {s: solve(guess_of(graph, s), limit) for s in starts}
        return {
            f"{title}{s.replace('_', ' ')}, chi2/dof {r.reduced_chi2:.3g}": r.graph
            for s, r in solved.items()
        }

    all_starts = ("odometry", "spanning_tree", "masat", GROUND_TRUTH)
    cell = by_name.get(("Manhattan3500", _LEVEL))
    if cell is not None:
        case = _telling(cell, "spanning_tree", "masat")
        draw(
            1,
            results(case, ("spanning_tree", "masat", GROUND_TRUTH)),
            f"Gauss-Newton from the spanning tree, from MASAT and from the truth: {case.name}.",
            3,
        )
    cell = by_name.get(("City10k", (0.3, 0.3, 0.3)))
    if cell is not None:
        case = _telling(cell, "spanning_tree", "masat")
        graph = instance(case)
        guess = guess_of(graph, "spanning_tree")
        draw(
            2,
            {
                "spanning tree": guess,
                "after Gauss-Newton": solve(guess, limit).graph,
                "truth": graph,
            },
            f"A bad guess, what Gauss-Newton makes of it, and the truth: {case.name}.",
            3,
        )
    if any(c.world == "Manhattan10000" for c in cells):
        case = Case("Manhattan10000", (0.0, 0.0, 0.1), 0)
        graph = instance(case)
        draw(
            3,
            {s.replace("_", " "): guess_of(graph, s) for s in all_starts},
            f"The guesses beside the truth, noise of the heading alone: {case.name}. A sigma of 0 "
            "leaves the measurement exact.",
            4,
        )
    for number, world in ((4, "Manhattan10000"), (5, "Manhattan3500")):
        cell = by_name.get((world, _LEVEL))
        if cell is not None:
            case = _telling(cell, "spanning_tree", "masat")
            draw(
                number,
                results(case, all_starts),
                f"After at most {limit} iterations of Gauss-Newton from each start: {case.name}.",
                4,
            )
    levels: list[Sigma] = [(s, s, s) for s in (0.1, 0.2, 0.35)]
    if all(("City10k", level) in by_name for level in levels):
        panels: dict[str, PoseGraph] = {}
        for level in levels:
            case = Case("City10k", level, 0)
            panels |= results(case, all_starts, f"{level[0]:g}: ")
        draw(6, panels, "City10k at .1, .2 and .35 after Gauss-Newton from each start.", 4)
    return figures


def _telling(cell: Cell, fails: str, succeeds: str) -> Case:
    """Return the first instance where one start fails and the other succeeds, or else the first."""
    for k in sorted(cell.trials[succeeds]):
        theirs = cell.trials[fails].get(k)
        if (
            theirs is not None
            and theirs.success() is None
            and cell.trials[succeeds][k].success() is not None
        ):
            return Case(cell.world, cell.sigma, k)
    return Case(cell.world, cell.sigma, 0)


def time_figure(cells: list[Cell], start: str, path: Path) -> Figure:
    """Draw the time of a start over the noise levels, with its spread."""
    from matplotlib.figure import Figure as Canvas

    worlds = list(dict.fromkeys(c.world for c in cells))
    canvas = Canvas(figsize=(5 * len(worlds), 4), layout="constrained")
    for k, world in enumerate(worlds, 1):
        mine = [c for c in cells if c.world == world]
        ax = canvas.add_subplot(1, len(worlds), k)
        ax.boxplot([c.start_ms(start) for c in mine], showfliers=False, whis=(5, 95))
        ax.set_xticks(range(1, len(mine) + 1), [c.level for c in mine], rotation=45, ha="right")
        ax.set_title(world)
        ax.set_ylim(bottom=0)
        ax.set_ylabel(f"{start}, ms")
    canvas.savefig(path, dpi=110)
    return Figure(
        path,
        f"Time of {start} over the noise levels: median, quartiles, and the 5 to 95 % range of all "
        "instances.",
    )


def rate_figure(cells: list[Cell], starts: tuple[str, ...], path: Path) -> Figure:
    """Draw the success rates of the starts over the noise levels, with their intervals."""
    from matplotlib.figure import Figure as Canvas

    from masat.study.statistics import wilson

    worlds = list(dict.fromkeys(c.world for c in cells))
    canvas = Canvas(figsize=(5 * len(worlds), 4), layout="constrained")
    shift: Callable[[int], float] = lambda i: 0.12 * (i - (len(starts) - 1) / 2)  # noqa: E731
    for k, world in enumerate(worlds, 1):
        mine = [c for c in cells if c.world == world]
        ax = canvas.add_subplot(1, len(worlds), k)
        for i, start in enumerate(starts):
            rates = np.array(
                [(k / n, *wilson(k, n)) for k, n in (c.rate(start) for c in mine) if n]
            )
            if len(rates) == len(mine):
                middle, low, high = rates.T
                ax.errorbar(
                    np.arange(len(mine)) + shift(i),
                    middle,
                    [np.maximum(middle - low, 0), np.maximum(high - middle, 0)],
                    fmt="o",
                    markersize=4,
                    capsize=2,
                    label=start.replace("_", " "),
                )
        ax.set_xticks(range(len(mine)), [c.level for c in mine], rotation=45, ha="right")
        ax.set_ylim(-0.03, 1.03)
        ax.set_title(world)
        ax.set_ylabel("success rate")
    handles, labels = ax.get_legend_handles_labels()
    canvas.legend(handles, labels, loc="outside upper center", ncols=len(starts))
    canvas.savefig(path, dpi=110)
    return Figure(path, "Success rates with 95 % Wilson intervals, by the relative threshold.")
