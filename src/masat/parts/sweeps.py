"""Tasks that go up the tree of the pieces, and down again."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from masat.parts.engines import Engine
from masat.parts.index import Index


def up(index: Index, engine: Engine, task: Callable[..., Any], jobs: Sequence[Any]) -> list[Any]:
    """Return what stands for the result of a task about each piece, which takes its children's.

    Parameters
    ----------
    index : Index
        The index of the partition.
    engine : Engine
        Where tasks run.
    task : callable
        Takes the file of a piece, its job, and the results of its children.
    jobs : sequence
        One a piece.
    """
    files, found = engine.files(), list[Any]()
    for k, entry in enumerate(index.pieces):
        below = [found[c] for c in entry.children]
        found.append(engine.submit(k, task, files[k], jobs[k], below))
    return found


def down(
    index: Index,
    engine: Engine,
    task: Callable[..., Any],
    jobs: Sequence[Any],
    found: Sequence[Any],
    target: str,
) -> list[Any]:
    """Return what stands for the result of a task about each piece, which takes its parent's.

    Parameters
    ----------
    index, engine, jobs
        As of `up`.
    task : callable
        Takes the file of a piece, its job, what `up` found for its children, the result of its
        parent or None, and the name of the poses that it writes.
    found : sequence
        What `up` returned.
    target : str
        That name.
    """
    files, out = engine.files(), [None] * len(index.pieces)
    for k in reversed(range(len(index.pieces))):
        entry = index.pieces[k]
        below = [found[c] for c in entry.children]
        above = out[entry.parent] if entry.parent >= 0 else None
        out[k] = engine.submit(k, task, files[k], jobs[k], below, above, target)
    return out
