"""Progress of long computations in notebooks."""

from __future__ import annotations

from html import escape
from time import perf_counter
from typing import Any

from masat.display import number
from masat.optimizers import Iteration
from masat.progress import Stage

# Seconds between two changes of the line: more often than this nobody can read, and each costs a
# message to the browser.
_PAUSE = 0.1


class Progress:
    """A line below a notebook's cell that tells how far a computation is.

    It is called with what `masat.solve`, `masat.optimize` and `masat.compare` report, and `advance`
    with what `masat.study.run_study` reports. Outside of a notebook it shows nothing.

    Parameters
    ----------
    what : str
        Words at the beginning of the line.
    total : int, optional
        With it, `advance` shows a bar.

    Examples
    --------
    >>> import masat
    >>> from masat.notebook import Progress
    >>> from masat.worlds import manhattan, perturb
    >>> graph = perturb(manhattan(200, 400, extent=10), (0.1, 0.1, 0.05))
    >>> show = Progress("solving")
    >>> result = masat.solve(graph, report=show, report_stage=show)
    """

    def __init__(self, what: str = "", total: int | None = None) -> None:
        self._what, self._total = what, total
        self._begin = perf_counter()
        self._shown = -_PAUSE
        self._done = self._iterations = 0
        self._stage = ""
        self._chi2: float | None = None
        self._handle: Any = None
        self._warnings: list[str] = []

    def __call__(self, step: Stage | Iteration) -> None:
        """Take note of a stage or of an iteration."""
        if isinstance(step, Stage):
            if step.warning:
                self._warnings.append(step.what)
            else:
                self._stage, self._iterations = step.what, 0
            self._chi2 = step.chi2 if step.chi2 is not None else self._chi2
            self._show(at_once=True)
        else:
            self._iterations += 1
            self._chi2 = step.chi2
            # The first lines are all shown: the last one may be among them.
            self._show(at_once=self._iterations <= 3)

    def advance(self, done: int = 1) -> None:
        """Take note of steps that are done, of `total`."""
        self._done += done
        self._show(at_once=self._done == self._total)

    def _show(self, *, at_once: bool) -> None:
        now = perf_counter()
        if not at_once and now - self._shown < _PAUSE:
            return
        if self._handle is None:
            self._handle = _new_handle()
        self._shown = now
        if self._handle is not False:
            from IPython.display import HTML

            self._handle.update(HTML(self.html))  # type: ignore[no-untyped-call]

    @property
    def html(self) -> str:
        """The line as HTML."""
        parts = [self._what, self._stage]
        if self._iterations:
            parts.append(f"iteration {self._iterations}")
        if self._chi2 is not None:
            parts.append(f"chi2 {number(self._chi2)}")
        if self._total is not None:
            parts.append(f"{self._done:,} of {self._total:,}")
        parts.append(f"{perf_counter() - self._begin:.1f} s")
        line = " \u00b7 ".join(escape(part) for part in parts if part)
        bar = ""
        if self._total is not None:
            bar = f'<progress value="{self._done}" max="{max(self._total, 1)}"></progress> '
        notes = "".join(f"<div>note: {escape(text)}</div>" for text in self._warnings)
        return f"<div>{bar}{line}</div>{notes}"


def _new_handle() -> Any:
    """Return a place below the cell, or False where there is no notebook."""
    try:
        from IPython import get_ipython
        from IPython.display import HTML, display
    except ImportError:
        return False
    shell = get_ipython()
    # In a terminal IPython has a shell too, which can show no HTML.
    if shell is None or not hasattr(shell, "kernel"):
        return False
    return display(HTML(""), display_id=True)  # type: ignore[no-untyped-call]
