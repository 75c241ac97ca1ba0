"""Signals that end a command."""

from __future__ import annotations

import signal
import sys
import threading
from types import FrameType


def exit_on_termination() -> None:
    """Turn SIGTERM and SIGHUP into SystemExit, so that unfinished files are removed.

    By default these signals end the process at once, and a temporary file beside the output would
    stay. Signals that are ignored (as SIGHUP by nohup) or handled already are left alone.
    """
    if threading.current_thread() is not threading.main_thread():
        return
    for name in ("SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) == signal.SIG_DFL:
            signal.signal(number, _exit)


def _exit(number: int, frame: FrameType | None) -> None:
    # The exit code by which shells tell that a signal ended a process.
    sys.exit(128 + number)
