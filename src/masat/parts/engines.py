"""Where tasks run: in this process, or on a Dask cluster."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Protocol

from masat.errors import PartitionError
from masat.optimizers.losses import NamedLoss
from masat.parts.cost import homes
from masat.parts.index import Index
from masat.parts.tasks import PieceFile, hold, release


class Engine(Protocol):
    """Runs tasks that may take the results of others."""

    def map(self, function: Callable[..., Any], *arguments: Sequence[Any]) -> list[Any]:
        """Return what stands for the results of tasks, the arguments being those of `map`."""

    def gather(self, results: Iterable[Any]) -> list[Any]:
        """Wait for results and return them."""

    def files(self) -> list[Any]:
        """Return what stands for the `PieceFile` of each piece."""

    def release(self) -> None:
        """Free the systems of pieces, and the workspace of this thread."""


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
    folder : Path
        The folder of the partition.
    index : Index
        Its index.
    memory : int, optional
        How many bytes the systems of pieces may take together; what is thrown out is computed
        again. The system in use is always held. Default: a quarter of the machine's memory.
    loss : tuple of str and float, optional
        Name and scale of the loss that is minimized. Default: chi2 is.
    trusted : list of bytes, optional
        `PieceFile.trusted` of each piece. Default: the loss applies to all edges.
    threads : int
        Threads that compute a task.
    """

    def __init__(
        self,
        folder: Path,
        index: Index,
        memory: int | None = None,
        loss: NamedLoss | None = None,
        trusted: list[bytes] | None = None,
        threads: int = 1,
    ) -> None:
        limit = _quarter_of_machine() if memory is None else memory
        self._folder = _where(folder)
        self._files = _files_of(folder, index, limit, loss, trusted, threads)

    def files(self) -> list[PieceFile]:
        """Return the `PieceFile` of each piece."""
        return self._files

    def map(self, function: Callable[..., Any], *arguments: Sequence[Any]) -> list[Any]:
        """Return what stands for the results of tasks."""
        return [_Deferred(function, own) for own in zip(*arguments, strict=True)]

    def gather(self, results: Iterable[Any]) -> list[Any]:
        """Run tasks, those before them first, and return their results."""
        return [_known(result) for result in results]

    def release(self) -> None:
        """Free the systems of this process, and the workspace of this thread."""
        release(self._folder)


class OnCluster:
    """Runs tasks on the workers of a Dask cluster.

    The system of each piece begins on a worker of its own choice. Dask runs the other tasks where
    that is, and all tasks of a worker that dies elsewhere.

    Parameters
    ----------
    client : distributed.Client
        The client of the cluster.
    folder : Path
        The folder of the partition.
    index : Index
        Its index.
    loss, trusted, threads
        As of `InTurn`.
    """

    def __init__(
        self,
        client: Any,
        folder: Path,
        index: Index,
        loss: NamedLoss | None = None,
        trusted: list[bytes] | None = None,
        threads: int = 1,
    ) -> None:
        self._client, self._folder, self._index = client, folder, index
        self._loss, self._trusted, self._threads = loss, trusted, threads
        self._files: list[Any] | None = None
        workers = self._workers()
        if not workers:
            raise PartitionError(
                f"the cluster at {client.scheduler.address} has no workers: start some with "
                "dask worker"
            )
        self._home = [workers[home] for home in homes(index, len(workers))]

    def map(self, function: Callable[..., Any], *arguments: Sequence[Any]) -> list[Any]:
        """Return the futures of tasks."""
        futures: list[Any] = self._client.map(function, *arguments, pure=False)
        return futures

    def gather(self, results: Iterable[Any]) -> list[Any]:
        """Wait for futures; choose other workers for the pieces of dead ones."""
        found: list[Any] = self._client.gather(list(results))
        workers = self._workers()
        if workers and not set(self._home) <= set(workers):
            self._home = [
                home if home in workers else workers[k % len(workers)]
                for k, home in enumerate(self._home)
            ]
            self._files = None
        return found

    def files(self) -> list[Any]:
        """Return the future of the `PieceFile` of each piece, which lies where its system is."""
        if self._files is None:
            needed: dict[str, int] = dict.fromkeys(self._home, 0)
            for home, entry in zip(self._home, self._index.pieces, strict=True):
                needed[home] += entry.memory
            limit = max(needed.values())
            files = _files_of(
                self._folder, self._index, limit, self._loss, self._trusted, self._threads
            )
            self._files = [
                self._client.submit(
                    hold, file, workers=[home], allow_other_workers=True, pure=False
                )
                for file, home in zip(files, self._home, strict=True)
            ]
            self._client.gather(self._files)
            # A choice of workers that are all dead would be waited for.
            free = {future.key: None for future in self._files}
            self._client.sync(self._client.scheduler.set_restrictions, worker=free)
        return self._files

    def release(self) -> None:
        """Free the systems of all workers that are left; their threads keep workspace."""
        self._files = None
        # What the solve ended with matters more than a cluster that is gone.
        with suppress(Exception):
            self._client.run(release, _where(self._folder), on_error="ignore")

    def _workers(self) -> list[str]:
        return sorted(self._client.scheduler_info(n_workers=-1)["workers"])


def _files_of(
    folder: Path,
    index: Index,
    limit: int,
    loss: NamedLoss | None,
    trusted: list[bytes] | None,
    threads: int,
) -> list[PieceFile]:
    where = _where(folder)
    flags: Sequence[bytes | None] = trusted or [None] * len(index.pieces)
    return [
        PieceFile(
            folder=where,
            name=entry.file,
            graph_hash=index.graph,
            file_hash=entry.hash,
            memory=entry.memory,
            limit=limit,
            loss=loss,
            trusted=own,
            threads=threads,
        )
        for entry, own in zip(index.pieces, flags, strict=True)
    ]


def _where(folder: Path) -> str:
    return str(folder.resolve())


def _quarter_of_machine() -> int:
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // 4
    except (AttributeError, ValueError, OSError):
        return 1 << 30
