"""How far a download has come, on a terminal."""

from __future__ import annotations

from rich.console import Console
from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn


class Bar:
    """A progress bar as pooch wants one; it vanishes with its context.

    Attributes
    ----------
    total : int
        Bytes to come, 0 if the server does not tell; pooch sets it.
    """

    total: int = 0

    def __init__(self, name: str) -> None:
        self._bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            DownloadColumn(),
            console=Console(stderr=True),
            transient=True,
        )
        self._task = self._bar.add_task(name, total=None)

    def update(self, count: int) -> None:
        """Take note of so many more bytes."""
        self._bar.update(self._task, advance=count, total=self.total or None)

    def reset(self) -> None:
        """Begin again at none."""
        self._bar.reset(self._task)

    def close(self) -> None:
        """Remove the bar."""
        self._bar.stop()

    def __enter__(self) -> Bar:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
