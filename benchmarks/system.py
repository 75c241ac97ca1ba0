"""The normal equations in NumPy: what CHOLMOD factorizes, and a check of the core's."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from masat import PoseGraph, lie
from masat.arrays import Floats, Ids


@dataclass(frozen=True)
class System:
    """The lower triangle of H as triplets, of which several may name one entry."""

    size: int
    rows: Ids
    columns: Ids
    values: Floats

    def diagonal(self) -> Floats:
        """Return the diagonal of H."""
        on = self.rows == self.columns
        return _sums(self.rows[on], self.values[on], self.size)

    def times(self, x: Floats) -> Floats:
        """Return H x."""
        below = self.rows != self.columns
        return _sums(self.rows, self.values * x[self.columns], self.size) + _sums(
            self.columns[below], self.values[below] * x[self.rows[below]], self.size
        )

    def norm(self) -> float:
        """Return an upper bound of the maximum norm of H, exact but for terms that cancel."""
        below = self.rows != self.columns
        size = np.abs(self.values)
        sums = _sums(self.rows, size, self.size) + _sums(
            self.columns[below], size[below], self.size
        )
        return float(sums.max())

    def backward_error(self, x: Floats, b: Floats) -> float:
        """Return the relative change of H and b, in the maximum norm, that makes x exact."""
        missing = np.abs(self.times(x) - b).max()
        return float(missing / (self.norm() * np.abs(x).max() + np.abs(b).max()))

    def residual(self, x: Floats, b: Floats) -> float:
        """Return |H x - b| / |b|."""
        return float(np.linalg.norm(self.times(x) - b) / np.linalg.norm(b))


def assemble(graph: PoseGraph, free: Ids) -> System:
    """Return H = sum J' W J at the poses of the graph, over the free nodes (places in `ids`)."""
    assert graph.poses is not None
    ends = graph.edge_indices
    of_a, of_b = (_planar if graph.dimension == 2 else _spatial)(
        graph.measurements, graph.poses[ends[:, 0]], graph.poses[ends[:, 1]]
    )
    column = np.full(len(graph.ids), -1, np.int64)
    column[free] = np.arange(len(free))
    a, b = column[ends[:, 0]], column[ends[:, 1]]
    weighted_a, weighted_b = graph.information @ of_a, graph.information @ of_b
    mixed = _transposed(of_b) @ weighted_a  # row b, column a
    swap = a > b
    mixed[swap] = _transposed(mixed[swap])
    blocks = (
        (a, a, _transposed(of_a) @ weighted_a),
        (b, b, _transposed(of_b) @ weighted_b),
        (np.maximum(a, b), np.minimum(a, b), mixed),
    )
    parts = [_lower(row, column, block, graph.dof) for row, column, block in blocks]
    rows, columns, values = (np.concatenate(part) for part in zip(*parts, strict=True))
    return System(graph.dof * len(free), rows, columns, values)


def _sums(places: Ids, values: Floats, size: int) -> Floats:
    return np.asarray(np.bincount(places, values, size), np.float64)


def _transposed(m: Floats) -> Floats:
    return m.swapaxes(-1, -2)


def _lower(row: Ids, column: Ids, block: Floats, dof: int) -> tuple[Ids, Ids, Floats]:
    """Return the triplets of blocks, without fixed nodes and what lies above the diagonal."""
    within = np.arange(dof)
    rows, columns = np.broadcast_arrays(
        (dof * row)[:, None, None] + within[:, None], (dof * column)[:, None, None] + within
    )
    keep = (np.minimum(row, column) >= 0)[:, None, None] & (rows >= columns)
    return rows[keep], columns[keep], block[keep]


def _planar(z: Floats, a: Floats, b: Floats) -> tuple[Floats, Floats]:
    """Return the derivatives of (x, y, theta) of z^-1 a^-1 b by a and b, each moved by a * d."""
    seen = lie.between(a, b)
    c, s = np.cos(z[:, 2]), np.sin(z[:, 2])
    of_a = np.zeros((len(z), 3, 3))
    of_a[:, 0, 0] = of_a[:, 1, 1] = -c
    of_a[:, 0, 1], of_a[:, 1, 0] = -s, s
    # A turn of a by d moves b, seen from a, by -d (-y, x).
    of_a[:, 0, 2] = c * seen[:, 1] - s * seen[:, 0]
    of_a[:, 1, 2] = -s * seen[:, 1] - c * seen[:, 0]
    of_a[:, 2, 2] = -1
    turn = seen[:, 2] - z[:, 2]
    of_b = np.zeros((len(z), 3, 3))
    of_b[:, 0, 0] = of_b[:, 1, 1] = np.cos(turn)
    of_b[:, 1, 0] = np.sin(turn)
    of_b[:, 0, 1] = -of_b[:, 1, 0]
    of_b[:, 2, 2] = 1
    return of_a, of_b


def _spatial(z: Floats, a: Floats, b: Floats) -> tuple[Floats, Floats]:
    """Return the same of (translation, vector part of the quaternion)."""
    seen = lie.between(a, b)
    vector = lie.local(z, seen)[:, 3:]
    scalar = np.sqrt(np.maximum(0.0, 1 - np.square(vector).sum(axis=1)))
    out_of_z = _transposed(_rotation(z[:, 3:]))
    scaled, cross = scalar[:, None, None] * np.eye(3), _cross(vector)
    of_a, of_b = np.zeros((2, len(z), 6, 6))
    of_a[:, :3, :3] = -out_of_z
    of_a[:, :3, 3:] = 2 * out_of_z @ _cross(seen[:, :3])
    of_a[:, 3:, 3:] = (cross - scaled) @ out_of_z
    of_b[:, :3, :3] = out_of_z @ _rotation(seen[:, 3:])
    of_b[:, 3:, 3:] = cross + scaled
    return of_a, of_b


def _cross(v: Floats) -> Floats:
    m = np.zeros((len(v), 3, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        m[:, i, j], m[:, j, i] = -v[:, k], v[:, k]
    return m


def _rotation(q: Floats) -> Floats:
    cross = _cross(q[:, :3])
    twice: Floats = 2 * cross
    turned: Floats = np.eye(3) + q[:, 3, None, None] * twice + twice @ cross
    return turned
