"""The progress of a download on a terminal."""

from __future__ import annotations

from rich.console import Console
from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn


class Bar:
    """A progress bar with the interface that pooch expects; it disappears with its context.

    Attributes
    ----------
    total : int
        Size of the download in bytes, 0 if the server does not say; set by pooch.
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
        """Advance by a number of bytes."""
        self._bar.update(self._task, advance=count, total=self.total or None)

    def reset(self) -> None:
        """Go back to zero bytes."""
        self._bar.reset(self._task)

    def close(self) -> None:
        """Remove the bar."""
        self._bar.stop()

    def __enter__(self) -> Bar:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
