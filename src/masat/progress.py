"""What a long computation tells on its way, and when it has to stop."""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter
from typing import NamedTuple, TypeAlias

from masat.errors import OptimizationError


class Stage(NamedTuple):
    """What a long computation is doing.

    Attributes
    ----------
    what : str
        A few words, such as "searching in 3 uncertified parts".
    chi2 : float or None
        The lowest chi2 so far, if there are poses yet.
    seconds : float
        Wall time since the computation began.
    warning : bool
        Whether the words are a warning about the graph, which the user should see at once.
    """

    what: str
    chi2: float | None
    seconds: float
    warning: bool = False


ReportStage: TypeAlias = Callable[[Stage], object]
"""Called at the beginning of each stage."""


class Progress:
    """Reports the stages of a computation and tells it when its time is over.

    Parameters
    ----------
    budget : float, optional
        Seconds after which the computation ends with the best that it has found. Default: no limit.
    report : callable, optional
        Called with each `Stage`.
    catch_interrupts : bool
        Whether Ctrl-C ends the computation with the best that it has found, instead of raising
        KeyboardInterrupt.
    """

    def __init__(
        self,
        budget: float | None = None,
        report: ReportStage | None = None,
        *,
        catch_interrupts: bool = False,
    ) -> None:
        if budget is not None and not budget >= 0:
            raise OptimizationError(f"the time budget must not be negative, got {budget}")
        self._start = perf_counter()
        self._budget = budget
        self._report = report
        self._catch_interrupts = catch_interrupts
        self._interrupted = False

    def tell(self, what: str, chi2: float | None = None, *, warning: bool = False) -> None:
        """Report a stage, or a warning."""
        if self._report is not None:
            self._report(Stage(what, chi2, perf_counter() - self._start, warning))

    def interrupt(self) -> None:
        """Take note of the KeyboardInterrupt being handled, or raise it again."""
        if not self._catch_interrupts:
            raise
        self._interrupted = True

    @property
    def over(self) -> bool:
        """Whether the computation has to end: its time is spent, or the user interrupted it."""
        spent = self._budget is not None and perf_counter() - self._start > self._budget
        return self._interrupted or spent
