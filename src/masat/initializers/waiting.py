"""The bodies that wait to be placed, and which of them are next."""

from __future__ import annotations

import heapq

import numpy as np

from masat.arrays import Floats, Ids, Indices


class WaitingBodies:
    """What ties each body that waits to those that are placed.

    Parameters
    ----------
    count : int
        Number of bodies.
    enough : int
        With so many measured positions a body is placed as soon as possible.

    Attributes
    ----------
    rows : list of list of int
        The edges that lead to each body.
    """

    def __init__(self, count: int, enough: int) -> None:
        self.rows: list[list[int]] = [[] for _ in range(count)]
        self._enough = enough
        self._positions, self._rotations = [0] * count, [0] * count
        self._position_weights, self._rotation_weights = [0.0] * count, [0.0] * count
        self._ready: set[int] = set()
        # Negative strengths of bodies, so that the strongest is first; only the last one counts.
        self._heap: list[tuple[int, float, int]] = []

    def add(self, bodies: Indices, rows: Ids, positions: Floats, rotations: Floats) -> None:
        """Add edges that lead to bodies, with their weights of positions and rotations."""
        order = np.argsort(bodies, kind="stable")
        bodies, rows = bodies[order], rows[order]
        positions, rotations = positions[order], rotations[order]
        begins = np.flatnonzero(np.diff(bodies, prepend=-1))
        if len(begins) == 0:
            return
        sums = (
            np.add.reduceat(values, begins).tolist()
            for values in (positions > 0, rotations > 0, positions, rotations)
        )
        ends = np.append(begins[1:], len(bodies))
        edges, parts = rows.tolist(), zip(begins.tolist(), ends.tolist(), strict=True)
        for body, (begin, end), p, r, position, rotation in zip(
            bodies[begins].tolist(), parts, *sums, strict=True
        ):
            self.rows[body] += edges[begin:end]
            self._positions[body] += p
            self._rotations[body] += r
            self._position_weights[body] += position
            self._rotation_weights[body] += rotation
            if self._positions[body] >= self._enough:
                self._ready.add(body)
            else:
                heapq.heappush(self._heap, self._entry(body))

    def take(self) -> list[int]:
        """Return all bodies with enough positions, or else the strongest, or else none."""
        if self._ready:
            bodies = sorted(self._ready)
            self._ready.clear()
        else:
            while self._heap and self._heap[0] != self._entry(self._heap[0][2]):
                heapq.heappop(self._heap)
            bodies = [heapq.heappop(self._heap)[2]] if self._heap else []
        return bodies

    def _entry(self, body: int) -> tuple[int, float, int]:
        count = self._positions[body] + self._rotations[body]
        return -count, -(self._position_weights[body] + self._rotation_weights[body]), body
