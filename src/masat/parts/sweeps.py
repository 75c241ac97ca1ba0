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
    files, found = engine.files(), [None] * len(index.pieces)
    for level in _levels(index):
        below = [[found[c] for c in index.pieces[k].children] for k in level]
        results = engine.map(task, [files[k] for k in level], [jobs[k] for k in level], below)
        for k, result in zip(level, results, strict=True):
            found[k] = result
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
    for level in reversed(_levels(index)):
        entries = [index.pieces[k] for k in level]
        below = [[found[c] for c in entry.children] for entry in entries]
        above = [out[entry.parent] if entry.parent >= 0 else None for entry in entries]
        own, targets = [jobs[k] for k in level], [target] * len(level)
        results = engine.map(task, [files[k] for k in level], own, below, above, targets)
        for k, result in zip(level, results, strict=True):
            out[k] = result
    return out


def _levels(index: Index) -> list[list[int]]:
    """Return the pieces by how many are below each other from them down, the parts first."""
    height: list[int] = []
    levels: list[list[int]] = []
    for k, entry in enumerate(index.pieces):
        height.append(1 + max((height[c] for c in entry.children), default=-1))
        if height[k] == len(levels):
            levels.append([])
        levels[height[k]].append(k)
    return levels
