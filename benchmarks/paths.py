"""A path: one way of one solver from a file to a map."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter
from typing import TypeAlias

import numpy as np

from masat.arrays import Floats

LIMIT = 50
"""Iterations after which a path has failed."""


@dataclass(frozen=True)
class Run:
    """What a path did.

    Attributes
    ----------
    load, start, optimize : float
        Times in ms.
    history : list of float
        The solver's own objective after each iteration.
    poses : ndarray, (n, 3) or (n, 7)
        In the order of the ids; taken out of the solver after the clock stopped.
    """

    load: float
    start: float
    optimize: float
    history: list[float]
    poses: Floats

    @property
    def total(self) -> float:
        """Time in ms from the file to the map."""
        return self.load + self.start + self.optimize


Path: TypeAlias = Callable[[int], Run]
"""Called with a number of iterations; may raise where the solver refuses."""


class Clock:
    """Times the laps of a path."""

    def __init__(self) -> None:
        self._begin = perf_counter()

    def lap(self) -> float:
        """Return the ms since the last lap."""
        now = perf_counter()
        self._begin, before = now, self._begin
        return 1e3 * (now - before)


def settled(before: float, after: float) -> bool:
    """Tell whether an iteration changed the objective by less than 1e-8 of it."""
    return abs(before - after) <= 1e-8 * abs(after) or not np.isfinite(after)


def from_rotations(rotations: Floats, translations: Floats) -> Floats:
    """Return poses with quaternions in place of rotation matrices (Shepperd's method)."""
    r = rotations
    trace = np.trace(r, axis1=1, axis2=2)
    # 4 q q' of q = (x, y, z, w): any of its columns is parallel to q, the longest most exactly.
    products = np.empty((len(r), 4, 4))
    products[:, :3, :3] = r + r.swapaxes(1, 2) + (1 - trace)[:, None, None] * np.eye(3)
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        products[:, i, 3] = products[:, 3, i] = r[:, k, j] - r[:, j, k]
    products[:, 3, 3] = 1 + trace
    largest = np.einsum("kii->ki", products).argmax(axis=1)
    q = products[np.arange(len(r)), largest]
    return np.hstack([translations, q / np.linalg.norm(q, axis=1, keepdims=True)])
