"""One thread for everybody, unless a row of a table says otherwise."""

from __future__ import annotations

import os
import sys

# OMP_THREAD_LIMIT binds also the libraries that set their number themselves.
_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OMP_THREAD_LIMIT", "OPENBLAS_NUM_THREADS"), "1")


def single_threaded() -> None:
    """Start the program again where BLAS or OpenMP may use more than one thread."""
    if not _ONE_THREAD.items() <= os.environ.items():
        os.execve(
            sys.executable, [sys.executable, *sys.orig_argv[1:]], {**os.environ, **_ONE_THREAD}
        )
