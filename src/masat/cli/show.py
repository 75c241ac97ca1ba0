"""Tables, JSON and progress for people and machines."""

from __future__ import annotations

import json
import sys
import threading
from collections.abc import Sequence
from time import perf_counter
from typing import TYPE_CHECKING, Any, Self

import click

from masat.optimality.certificate import Certificate
from masat.optimizers import Iteration, Result

if TYPE_CHECKING:
    from rich.progress import Progress, ProgressColumn

_PATIENCE = 0.5  # seconds before a progress line appears


def as_json(values: dict[str, Any]) -> None:
    """Print a JSON object."""
    click.echo(json.dumps(values, indent=2))


def table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table, its first column to the left, the others to the right."""
    from rich import box
    from rich.console import Console
    from rich.table import Table

    grid = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for k, column in enumerate(columns):
        grid.add_column(column, justify="right" if k else "left", no_wrap=True)
    for row in rows:
        grid.add_row(*row)
    console = Console()
    # A pipe has no width: nothing is cut there.
    Console(width=None if console.is_terminal else 160).print(grid)


def number(value: float | None) -> str:
    """Return six digits, or a dash."""
    return "-" if value is None else f"{value:.6g}"


def duration(seconds: float) -> str:
    """Return milliseconds or seconds."""
    return f"{seconds * 1e3:.3g} ms" if seconds < 1 else f"{seconds:.2f} s"


def certificate(proof: Certificate | None) -> dict[str, Any] | None:
    """Return what JSON says of a certificate."""
    if proof is None:
        return None
    return {
        "certified": proof.certified,
        "message": proof.message,
        "chi2": proof.chi2,
        "optimum": proof.optimum,
        "chordal_cost": proof.cost,
        "bound": proof.bound,
        "gap": proof.gap,
        "exact": proof.exact,
    }


def summary(result: Result) -> dict[str, Any]:
    """Return what JSON says of a result."""
    return {
        "optimizer": result.method,
        "converged": result.converged,
        "reason": result.reason.name.lower(),
        "message": result.message,
        "iterations": result.iterations,
        "initial_chi2": result.initial_chi2,
        "chi2": result.chi2,
        "degrees_of_freedom": result.degrees_of_freedom,
        "reduced_chi2": result.reduced_chi2,
        "gauge": result.gauge.tolist(),
        "seconds": result.seconds,
        "history": [iteration._asdict() for iteration in result.history],
    }


class _Line:
    """A line on standard error that goes when the work is done.

    Nothing is shown for short work, to --quiet, and where standard error is no terminal.
    """

    def __init__(self, what: str, *, quiet: bool) -> None:
        self._what = what
        self._silent = quiet or not sys.stderr.isatty()
        self._bar: Progress | None = None

    def _show(self, *columns: ProgressColumn, total: int | None = None) -> Progress:
        from rich.console import Console
        from rich.progress import Progress

        self._bar = Progress(*columns, console=Console(stderr=True), transient=True)
        self._bar.add_task(self._what, total=total)
        self._bar.start()
        return self._bar

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.stop()


class Watch(_Line):
    """Shows the progress of an optimization."""

    def __init__(self, what: str, limit: int, *, quiet: bool) -> None:
        super().__init__(what, quiet=quiet)
        self._limit = limit
        self._since = perf_counter()
        self._count = 0

    def __call__(self, iteration: Iteration) -> None:
        """Take note of an iteration."""
        self._count += 1
        bar = self._bar
        if self._silent or (bar is None and perf_counter() - self._since < _PATIENCE):
            return
        if bar is None:
            from rich.progress import BarColumn, TextColumn, TimeElapsedColumn

            bar = self._show(
                TextColumn("{task.description}"),
                BarColumn(),
                TextColumn("{task.completed} of at most {task.total} iterations"),
                TimeElapsedColumn(),
                total=self._limit,
            )
        bar.update(
            bar.task_ids[0],
            completed=self._count,
            description=f"{self._what}  chi2 {iteration.chi2:.6g}",
        )


class Wait(_Line):
    """Shows the time that goes by, for work that does not report."""

    def __enter__(self) -> Self:
        self._timer = threading.Timer(_PATIENCE, self._start)
        if not self._silent:
            self._timer.daemon = True
            self._timer.start()
        return self

    def _start(self) -> None:
        from rich.progress import SpinnerColumn, TextColumn, TimeElapsedColumn

        self._show(SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())

    def __exit__(self, *_: object) -> None:
        if not self._silent:
            self._timer.cancel()
            self._timer.join()
        super().__exit__()
