"""What a factorization by parts costs, from the index alone."""

from __future__ import annotations

from typing import NamedTuple

from masat.parts.index import Index


class Cost(NamedTuple):
    """What one iteration costs on a number of workers.

    Attributes
    ----------
    workers : int
        Number of workers.
    operations : float
        Floating-point operations of a factorization, all workers together.
    critical : float
        Operations that the last worker to finish has done or waited for, one core a worker.
    memory : int
        Bytes of the worker that holds the most: systems, workspace, and contribution blocks on
        their way to it.
    sent : int
        Bytes of the contribution blocks that go from one worker to another.
    """

    workers: int
    operations: float
    critical: float
    memory: int
    sent: int

    @property
    def speedup(self) -> float:
        """How many times faster than one worker, without the time of messages."""
        return self.operations / self.critical if self.critical else 1.0


def homes(index: Index, workers: int) -> list[int]:
    """Return the worker of each piece.

    Neighboring parts are together. A separator is with a part below it: with the worker, of these,
    that holds the least.
    """
    found: list[int] = []
    memory = [0] * workers
    below: list[list[int]] = []
    for k, entry in enumerate(index.pieces):
        if k < index.parts:
            home = k * workers // index.parts
            below.append([home])
        else:
            below.append(sorted({worker for c in entry.children for worker in below[c]}))
            home = min(below[k], key=memory.__getitem__)
        found.append(home)
        # Blocks of children stay until their parent has taken them in.
        memory[home] += entry.memory + sum(index.pieces[c].message for c in entry.children)
    return found


def cost(index: Index, workers: int) -> Cost:
    """Return what an iteration costs on a number of workers.

    Each worker takes its pieces in the order of the index, as soon as those below are done.
    """
    home = homes(index, workers)
    memory, workspace, free = [0] * workers, [0] * workers, [0.0] * workers
    done: list[float] = []
    sent = 0
    for k, entry in enumerate(index.pieces):
        begin = max([free[home[k]], *(done[c] for c in entry.children)])
        done.append(begin + entry.operations)
        free[home[k]] = done[k]
        memory[home[k]] += entry.memory
        workspace[home[k]] = max(workspace[home[k]], entry.workspace)
        if entry.parent >= 0:
            # Blocks of children stay until their parent has taken them in.
            memory[home[entry.parent]] += entry.message
            if home[entry.parent] != home[k]:
                sent += entry.message
    operations = sum(entry.operations for entry in index.pieces)
    largest = max(m + w for m, w in zip(memory, workspace, strict=True))
    return Cost(workers, operations, max(done, default=0.0), largest, sent)


def table(index: Index) -> list[Cost]:
    """Return the costs on one worker, on two, on four, and so on up to one for each part."""
    counts, workers = [], 1
    while workers < index.parts:
        counts.append(workers)
        workers *= 2
    return [cost(index, count) for count in [*counts, index.parts]]
