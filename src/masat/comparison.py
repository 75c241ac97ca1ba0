"""A graph solved from every initial guess, side by side."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from time import perf_counter
from typing import TYPE_CHECKING, NamedTuple

from masat.display import duration, number, table_html
from masat.errors import InitializationError, MasatError
from masat.graph import PoseGraph
from masat.initializers import INITIALIZERS, guess_of
from masat.optimizers import Result, optimize
from masat.optimizers.termination import Report
from masat.progress import Progress, ReportStage

if TYPE_CHECKING:
    from masat.viewing import View

# chi2 this much above the best, relatively, is another minimum.
_SAME = 1e-6


class Run(NamedTuple):
    """One initial guess and where it led.

    Attributes
    ----------
    init : str
        Name of the initial guess.
    seconds : float
        Wall time of the initial guess.
    guess : PoseGraph
        The graph at the initial guess.
    result : Result
        What the optimizer made of it.
    """

    init: str
    seconds: float
    guess: PoseGraph
    result: Result


@dataclass(frozen=True, repr=False)
class Comparison:
    """What the initial guesses lead to. Jupyter displays it as a table.

    Attributes
    ----------
    runs : tuple of Run
        One for each initial guess that could be made, in the order of `INITIALIZERS`.
    failures : mapping of str to str
        Why the others could not be made, by name.
    """

    runs: tuple[Run, ...]
    failures: Mapping[str, str]

    columns = (
        "initial guess",
        "guess took",
        "initial chi2",
        "final chi2",
        "reduced",
        "iterations",
        "solve took",
        "end",
    )
    """Titles of the columns of the table."""

    @property
    def best(self) -> Run:
        """The first run of those with the lowest chi2."""
        return min(self.runs, key=lambda run: run.result.chi2)

    @property
    def rows(self) -> list[tuple[str, ...]]:
        """The texts of the table, a row for each run.

        The last one is "best", "local minimum", or why the optimizer stopped without a minimum.
        """
        return [
            (
                r.init,
                duration(r.seconds),
                number(r.result.initial_chi2),
                number(r.result.chi2),
                number(r.result.reduced_chi2),
                str(r.result.iterations),
                duration(r.result.seconds),
                self._end(r.result),
            )
            for r in self.runs
        ]

    def __repr__(self) -> str:
        best = self.best
        return f"Comparison({len(self.runs)} runs, best chi2 {best.result.chi2:.6g} ({best.init}))"

    def _repr_html_(self) -> str:
        failed = [f"{init} fails: {reason}" for init, reason in self.failures.items()]
        return table_html(self.columns, self.rows, failed)

    def view(self, path: str | os.PathLike[str] | None = None, *, title: str = "masat") -> View:
        """Make an interactive view whose slider goes through the maps, the best one last.

        Parameters
        ----------
        path : path-like, optional
            File for the page. Without it the page is only returned.
        title : str
            Title of the page.

        Returns
        -------
        View
            As of `masat.view`.
        """
        from masat.viewing import view

        best = self.best
        others = {f"from {r.init}": r.result.graph for r in self.runs if r is not best}
        return view(best.result, path, before=others, title=f"{title}, best from {best.init}")

    def _end(self, result: Result) -> str:
        if not result.converged:
            return result.reason.name.lower().replace("_", " ")
        return "best" if result.chi2 <= self.best.result.chi2 * (1 + _SAME) else "local minimum"


def compare(
    graph: PoseGraph,
    optimizer: str = "levenberg_marquardt",
    *,
    max_iterations: int = 100,
    relative_tolerance: float = 1e-9,
    threads: int | None = None,
    report: Report | None = None,
    report_stage: ReportStage | None = None,
) -> Comparison:
    """Solve a graph from every initial guess.

    Parameters
    ----------
    graph : PoseGraph
        The graph.
    optimizer, max_iterations, relative_tolerance, threads, report, report_stage
        As of `masat.solve`; the reports are of all initial guesses, one after the other.

    Returns
    -------
    Comparison
        Jupyter displays it as a table.

    Raises
    ------
    InitializationError
        If no initial guess can be made.

    Examples
    --------
    >>> import masat
    >>> from masat.worlds import manhattan, perturb
    >>> found = masat.compare(perturb(manhattan(200, 400, extent=10), (0.1, 0.1, 0.05)))
    >>> found.best.result.converged
    True
    """
    runs, failures = [], {}
    for init in INITIALIZERS:
        try:
            runs.append(
                run_from(
                    graph,
                    init,
                    optimizer,
                    report=report,
                    report_stage=report_stage,
                    max_iterations=max_iterations,
                    relative_tolerance=relative_tolerance,
                    threads=threads,
                )
            )
        except MasatError as failure:
            failures[init] = str(failure)
    return comparison_of(runs, failures)


def run_from(
    graph: PoseGraph,
    init: str,
    optimizer: str,
    *,
    report: Report | None = None,
    report_stage: ReportStage | None = None,
    max_iterations: int = 100,
    relative_tolerance: float = 1e-9,
    threads: int | None = None,
) -> Run:
    """Solve a graph from one initial guess; parameters as of `compare`."""
    begin = perf_counter()
    guess = guess_of(graph, init, progress=Progress(report=report_stage))
    seconds = perf_counter() - begin
    result = optimize(
        guess,
        optimizer,
        report=report,
        max_iterations=max_iterations,
        relative_tolerance=relative_tolerance,
        threads=threads,
    )
    return Run(init, seconds, guess, result)


def comparison_of(runs: list[Run], failures: Mapping[str, str]) -> Comparison:
    """Return a comparison; without any run, raise the reason of the first failure."""
    if not runs:
        reason = next(iter(failures.values()))
        raise InitializationError(f"no initial guess leads anywhere: {reason}")
    return Comparison(tuple(runs), failures)
