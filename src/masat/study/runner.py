"""Running a study on an executor: the cores of this machine, or a cluster."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor, Future, as_completed
from typing import TypeAlias

from masat.study.store import Store
from masat.study.trial import Trial, run_case
from masat.study.worlds import load_world

Progress: TypeAlias = Callable[[int], object]
"""Called with the number of runs that were finished since the last call."""


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
        Filled case by case; a study that is killed loses only the cases that are running.
    executor : concurrent.futures.Executor
        Threads are enough: the core releases the interpreter's lock.
    progress : callable, optional
        Called with the number of runs: first of those found in the store, then of each case.
    run : callable
        Runs a case; `masat.study.cluster.on_cluster` makes one that runs it on a cluster.

    Raises
    ------
    StudyError
        If a world cannot be loaded, before any case has run, or the store cannot be written.
    """
    design, done = store.design, store.done()
    todo = [
        (case, inits)
        for case in design.cases()
        if (inits := tuple(i for i in design.inits_of(case) if (case, i) not in done))
    ]
    # Loaded here, a world that is missing ends the study before it begins, and no two threads
    # load the same one.
    for world in dict.fromkeys(case.world for case, _ in todo if case.sigma):
        load_world(world)
    if progress is not None:
        progress(len(done))
    pending: dict[Future[list[Trial]], int] = {}
    for case, inits in todo:
        pending[executor.submit(run, case, inits, design.max_iterations)] = len(inits)
    try:
        for future in as_completed(pending):
            store.add(future.result())
            if progress is not None:
                progress(pending.pop(future))
    finally:
        for future in pending:
            future.cancel()
