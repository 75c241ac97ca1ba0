"""Running cases on a Dask cluster."""

from __future__ import annotations

import asyncio
import concurrent.futures
from collections.abc import Callable
from typing import Any

from masat.study.names import Case, StudyError
from masat.study.trial import Trial, run_case

_TRIES = 5


def on_cluster(client: Any) -> Callable[[Case, tuple[str, ...], int], list[Trial]]:
    """Return a `run` for `run_study` that has a Dask client run each case, and waits for it.

    A case is given again to the cluster if a worker dies with it, or with its result before that
    has come in: the futures of `Client.get_executor` then fail or never end.
    """

    def run(case: Case, starts: tuple[str, ...], max_iterations: int) -> list[Trial]:
        from distributed import KilledWorker

        lost = (asyncio.CancelledError, concurrent.futures.CancelledError, KilledWorker)
        for _ in range(_TRIES):
            future = client.submit(
                run_case, case, starts, max_iterations, pure=False, retries=_TRIES
            )
            try:
                trials: list[Trial] = future.result()
            except lost:
                continue
            return trials
        raise StudyError(
            f"the cluster lost {case.name} {_TRIES} times; what came in is kept: run the same "
            "command again to go on"
        )

    return run
