"""Running a study on an executor: the cores of this machine, or a cluster."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor, Future, as_completed
from pathlib import Path
from typing import TypeAlias

from masat.study.cases import AnyTrial, run_case
from masat.study.names import StudyError
from masat.study.store import Store
from masat.study.worlds import is_path, load_world

Progress: TypeAlias = Callable[[int], object]
"""Called with the number of runs that were finished since the last call."""


def run_study(
    store: Store,
    executor: Executor,
    *,
    progress: Progress | None = None,
    run: Callable[..., Sequence[AnyTrial]] = run_case,
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
        If a world cannot be loaded or a file is missing, before any case has run, or the store
        cannot be written.
    """
    design, done = store.design, store.done()
    todo = [
        (case, columns)
        for case in design.cases()
        if (columns := tuple(c for c in design.columns_of(case) if (case, c) not in done))
    ]
    # Loaded here, a world that is missing ends the study before it begins, and no two threads
    # load the same one.
    for case, _ in todo:
        if case.sigma:
            load_world(case.world)
        elif is_path(case.world) and not Path(case.world).is_file():
            raise StudyError(f"{case.world}: there is no such file")
    if progress is not None:
        progress(len(done))
    pending: dict[Future[Sequence[AnyTrial]], int] = {}
    for case, columns in todo:
        pending[executor.submit(run, case, columns, design.max_iterations)] = len(columns)
    try:
        for future in as_completed(pending):
            store.add(future.result())
            if progress is not None:
                progress(pending.pop(future))
    finally:
        for future in pending:
            future.cancel()
