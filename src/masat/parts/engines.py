"""Where tasks run: in this process, or on a Dask cluster."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from typing import Any, Protocol

from masat.errors import PartitionError
from masat.parts.index import Index
from masat.parts.tasks import limit_memory


class Engine(Protocol):
    """Runs tasks that may take the results of others."""

    def submit(self, piece: int, function: Callable[..., Any], *arguments: Any) -> Any:
        """Return what stands for the result of a task about a piece."""

    def gather(self, results: Iterable[Any]) -> list[Any]:
        """Wait for results and return them."""


class _Deferred:
    """A task of this process, run when its result is first asked for."""

    def __init__(self, function: Callable[..., Any], arguments: tuple[Any, ...]) -> None:
        self._call: tuple[Callable[..., Any], tuple[Any, ...]] | None = (function, arguments)
        self._result: Any = None

    def result(self) -> Any:
        if self._call is not None:
            function, arguments = self._call
            self._result = function(*map(_known, arguments))
            self._call = None
        return self._result


def _known(argument: Any) -> Any:
    if isinstance(argument, _Deferred):
        return argument.result()
    if isinstance(argument, list):
        return [_known(one) for one in argument]
    return argument


class InTurn:
    """Runs one task after the other in this process.

    Parameters
    ----------
    memory : int, optional
        How many bytes the systems of pieces may take together; what is thrown out is computed
        again. The system in use is always held. Default: a quarter of the machine's memory.
    """

    def __init__(self, memory: int | None = None) -> None:
        limit_memory(_quarter_of_machine() if memory is None else memory)

    def submit(self, piece: int, function: Callable[..., Any], *arguments: Any) -> Any:
        """Return what stands for the result of a task about a piece."""
        return _Deferred(function, arguments)

    def gather(self, results: Iterable[Any]) -> list[Any]:
        """Run tasks, those before them first, and return their results."""
        return [_known(result) for result in results]


class OnCluster:
    """Runs tasks on the workers of a Dask cluster, each piece on the same one as long as it lives.

    Dask runs the tasks of a worker that dies again elsewhere.

    Parameters
    ----------
    client : distributed.Client
        The client of the cluster.
    index : Index
        The index of the partition.
    """

    def __init__(self, client: Any, index: Index) -> None:
        self._client = client
        workers = self._workers()
        if not workers:
            raise PartitionError(
                f"the cluster at {client.scheduler.address} has no workers: start some with "
                "dask worker"
            )
        self._home: list[str] = []
        for k, entry in enumerate(index.pieces):
            if k < index.parts:
                self._home.append(workers[k * len(workers) // index.parts])
            else:
                self._home.append(self._home[entry.children[0]])

    def submit(self, piece: int, function: Callable[..., Any], *arguments: Any) -> Any:
        """Return the future of a task about a piece."""
        return self._client.submit(
            function,
            *arguments,
            workers=[self._home[piece]],
            allow_other_workers=True,
            pure=False,
        )

    def gather(self, results: Iterable[Any]) -> list[Any]:
        """Wait for futures; give the pieces of dead workers to the others."""
        found: list[Any] = self._client.gather(list(results))
        workers = self._workers()
        for k, home in enumerate(self._home):
            if workers and home not in workers:
                self._home[k] = workers[k % len(workers)]
        return found

    def _workers(self) -> list[str]:
        return sorted(self._client.scheduler_info(n_workers=-1)["workers"])


def _quarter_of_machine() -> int:
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // 4
    except (AttributeError, ValueError, OSError):
        return 1 << 30
