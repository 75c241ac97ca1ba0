"""Lines on standard error that show how far long work is, and vanish when it is done.

Nothing is shown for short work, with --quiet, and where standard error is no terminal.
"""

from __future__ import annotations

import sys
import threading
from time import perf_counter
from typing import TYPE_CHECKING, Self

import click

from masat.optimizers import Iteration
from masat.progress import Stage

if TYPE_CHECKING:
    from rich.progress import Progress, ProgressColumn

_PATIENCE = 0.5  # seconds before a line appears


class _Line:
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
            self._bar = None


class _Counted(_Line):
    """A bar of something that is counted, from when it takes long."""

    def __init__(self, what: str, total: int, unit: str, *, quiet: bool) -> None:
        super().__init__(what, quiet=quiet)
        self._total, self._unit = total, unit
        self._since = perf_counter()

    def _count_up(self, done: int, description: str) -> None:
        bar = self._bar
        if self._silent or (bar is None and perf_counter() - self._since < _PATIENCE):
            return
        if bar is None:
            from rich.progress import BarColumn, TextColumn, TimeElapsedColumn

            bar = self._show(
                TextColumn("{task.description}"),
                BarColumn(),
                TextColumn("{task.completed} " + self._unit),
                TimeElapsedColumn(),
                total=self._total,
            )
        bar.update(bar.task_ids[0], completed=done, description=description)


class Iterations(_Counted):
    """Shows the iterations of an optimizer."""

    def __init__(self, what: str, limit: int, *, quiet: bool) -> None:
        super().__init__(what, limit, "of at most {task.total} iterations", quiet=quiet)
        self._count = 0

    def __call__(self, iteration: Iteration) -> None:
        """Take note of an iteration."""
        self._count += 1
        self._count_up(self._count, f"{self._what}  chi2 {iteration.chi2:.6g}")


class Steps(_Counted):
    """Shows how many steps of known number are done."""

    def __init__(self, what: str, total: int, *, quiet: bool) -> None:
        super().__init__(what, total, "of {task.total} steps", quiet=quiet)

    def advance(self, done: int) -> None:
        """Take note of how many steps are done."""
        self._count_up(done, self._what)


class Stages(_Line):
    """Shows the stage of long work, the lowest chi2 so far, and the time that goes by.

    A warning about the graph is printed at once, for people who wait.
    """

    def __init__(self, what: str, *, quiet: bool) -> None:
        super().__init__(what, quiet=quiet)
        self._stage = ""
        self.has_warned = False
        """Whether a warning was printed."""
        self._timer = threading.Timer(_PATIENCE, self._start)

    def __call__(self, stage: Stage) -> None:
        """Take note of a stage."""
        if stage.warning:
            if not self._silent:
                click.echo(f"note: {stage.what}", err=True)
                self.has_warned = True
            return
        chi2 = "" if stage.chi2 is None else f"  best chi2 {stage.chi2:.6g}"
        self._stage = f"  {stage.what}{chi2}"
        if self._bar is not None:
            self._bar.update(self._bar.task_ids[0], description=self._what + self._stage)

    def __enter__(self) -> Self:
        if not self._silent:
            self._timer.daemon = True
            self._timer.start()
        return self

    def _start(self) -> None:
        from rich.progress import SpinnerColumn, TextColumn, TimeElapsedColumn

        bar = self._show(SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
        bar.update(bar.task_ids[0], description=self._what + self._stage)

    def __exit__(self, *_: object) -> None:
        if not self._silent:
            self._timer.cancel()
            if self._timer.is_alive():
                self._timer.join()
        super().__exit__()
