"""Running cases on a Dask cluster."""

from __future__ import annotations

import asyncio
import concurrent.futures
from collections.abc import Callable, Sequence
from typing import Any

from masat.study.cases import AnyTrial, run_case
from masat.study.names import Case, StudyError

_TRIES = 5


def on_cluster(client: Any) -> Callable[[Case, tuple[str, ...], int], Sequence[AnyTrial]]:
    """Return a `run` for `run_study` that runs each case on a Dask cluster and waits for it.

    A case is submitted again if its worker dies before the result has arrived. The futures of
    `Client.get_executor` fail or never end in that situation.
    """

    def run(case: Case, columns: tuple[str, ...], max_iterations: int) -> Sequence[AnyTrial]:
        from distributed import KilledWorker

        lost = (asyncio.CancelledError, concurrent.futures.CancelledError, KilledWorker)
        for _ in range(_TRIES):
            future = client.submit(
                run_case, case, columns, max_iterations, pure=False, retries=_TRIES
            )
            try:
                trials: Sequence[AnyTrial] = future.result()
            except lost:
                continue
            return trials
        raise StudyError(
            f"the cluster lost {case.name} {_TRIES} times; all finished runs are stored: run the "
            "same command again to continue"
        )

    return run
