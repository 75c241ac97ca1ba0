"""Running a study on an executor: the machine's cores, or a cluster."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor, Future, as_completed
from typing import TypeAlias

from masat.study.store import Store
from masat.study.trial import Trial, run_case
from masat.study.worlds import load_world

Progress: TypeAlias = Callable[[int], object]
"""Called with the number of runs that came in."""


def run_study(
    store: Store,
    executor: Executor,
    *,
    progress: Progress | None = None,
    run: Callable[..., list[Trial]] = run_case,
) -> None:
    """Run what the store's design asks for and the store does not hold yet.

    Parameters
    ----------
    store : Store
        Filled case by case; a study that is killed loses only the cases in work.
    executor : concurrent.futures.Executor
        Threads do: the core releases the interpreter's lock.
    progress : callable, optional
        Called with the number of runs, first of those found in the store, then of each case.
    run : callable
        Runs a case; `masat.study.cluster.on_cluster` has a cluster do it.
    """
    # A world that cannot be had ends the study before it begins.
    for world in store.design.worlds:
        load_world(world)
    done = store.done()
    if progress is not None:
        progress(len(done))
    pending: dict[Future[list[Trial]], tuple[str, ...]] = {}
    for case in store.design.cases():
        starts = tuple(s for s in store.design.starts_of(case) if (case, s) not in done)
        if starts:
            future = executor.submit(run, case, starts, store.design.max_iterations)
            pending[future] = starts
    try:
        for future in as_completed(pending):
            store.add(future.result())
            if progress is not None:
                progress(len(pending.pop(future)))
    finally:
        for future in pending:
            future.cancel()
