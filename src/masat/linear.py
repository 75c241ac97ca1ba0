"""Quadratic problems on a graph: what the linear starts solve.

A node's unknown is a matrix X (d, k); an edge from i to j adds the trace of
X_i' first X_i + 2 X_i' joint X_j + X_j' second X_j. The anchors hold still.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from masat import _core
from masat.arrays import Floats
from masat.errors import InitializationError
from masat.graph import PoseGraph


class Weights(NamedTuple):
    """One number an edge, (m,), for its rotation and its translation."""

    rotation: Floats
    translation: Floats


class Form(NamedTuple):
    """The blocks of the edges, (m, d, d) each."""

    first: Floats
    joint: Floats
    second: Floats


def isotropic_weights(graph: PoseGraph) -> Weights:
    """Return the isotropic surrogates of the information matrices.

    A translation weighs d / trace(inverse of its block); of the rotations see `rotation_weights`.
    Source: Rosen, Carlone, Bandeira, Leonard, SE-Sync, IJRR 2019, section 3.
    """
    d = graph.dimension
    return Weights(rotation_weights(graph), d / _trace_of_inverse(graph.information[:, :d, :d]))


def rotation_weights(graph: PoseGraph) -> Floats:
    """Return the weights of the rotations, (m,).

    They make the chordal cost, weight |R_j - R_i R|^2, equal the chi2 of small errors: half the
    information of an angle in 2D, an eighth of that of the quaternion's vector part in 3D.
    """
    d = graph.dimension
    rotation = graph.information[:, d:, d:]
    if d == 2:
        return rotation[:, 0, 0] / 2
    return 3 / _trace_of_inverse(rotation) / 8


def _trace_of_inverse(a: Floats) -> Floats:
    """Return the traces of the inverses of positive definite matrices, (m, 2, 2) or (m, 3, 3).

    By the Cholesky factor L: the sum of the squares of its inverse. Positive, however badly
    conditioned.
    """
    d = a.shape[1]
    scale = np.einsum("kii->k", a)
    a = a / scale[:, None, None]

    def root(pivot: Floats, of: Floats) -> Floats:
        return np.asarray(np.sqrt(np.maximum(pivot, np.finfo(np.float64).eps * of)))

    l00 = root(a[:, 0, 0], a[:, 0, 0])
    l10 = a[:, 1, 0] / l00
    l11 = root(a[:, 1, 1] - l10**2, a[:, 1, 1])
    i00, i11 = 1 / l00, 1 / l11
    i10 = -l10 * i00 * i11
    total = i00**2 + i10**2 + i11**2
    if d == 3:
        l20 = a[:, 2, 0] / l00
        l21 = (a[:, 2, 1] - l20 * l10) / l11
        i22 = 1 / root(a[:, 2, 2] - l20**2 - l21**2, a[:, 2, 2])
        i21 = -l21 * i11 * i22
        i20 = -(l20 * i00 + l21 * i10) * i22
        total = total + i20**2 + i21**2 + i22**2
    return np.asarray(total / scale)


def rotation_form(graph: PoseGraph, weight: Floats) -> Form:
    """Return the form of weight |R_j - R_i R|^2, the unknowns being X_i = R_i'."""
    d = graph.dimension
    same = weight[:, None, None] * np.eye(d)
    return Form(same, -weight[:, None, None] * _core.rotation_matrices(graph.measurements), same)


class Minimizer:
    """The minima of a form that pulls shift: factorized once."""

    def __init__(self, graph: PoseGraph, form: Form, values: Floats) -> None:
        """Take a form; of `values`, (n, d, k), those of the anchors stand."""
        self._values = values
        self._free = graph.elimination.free_nodes()
        self.matrix = _core.GraphMatrix(graph.elimination, values.shape[1])
        self._forcing = self.matrix.assemble(graph.topology, *form, values)
        broken = self.matrix.factorize(np.zeros(self._forcing[..., 0].size))
        if broken >= 0:
            raise InitializationError(
                f"the edges around node {graph.ids[self._free[broken]]} do not determine it"
            )

    def __call__(self, pull: Floats) -> Floats:
        """Return the unknowns X that minimize the form less the traces of 2 X_i' pull_i.

        Parameters
        ----------
        pull : ndarray, (n, d, k)

        Returns
        -------
        ndarray, (n, d, k)
        """
        solution = self._values.copy()
        solution[self._free] = self.matrix.solve(self._forcing + pull[self._free])
        return solution


def rotations(poses: Floats) -> Floats:
    """Return the unknowns X_i = R_i' of poses, (n, d, d)."""
    return np.ascontiguousarray(_core.rotation_matrices(poses).transpose(0, 2, 1))


def nearest_rotations(graph: PoseGraph, poses: Floats, unknowns: Floats) -> Floats:
    """Return poses with the rotations nearest to unknowns X_i = R_i', (n, d, d).

    Translations, and the poses of the anchors, stand.
    """
    turned = _core.nearest_rotations(np.ascontiguousarray(unknowns.transpose(0, 2, 1)))
    turned[:, : graph.dimension] = poses[:, : graph.dimension]
    held = graph.index(graph.gauge)
    turned[held] = poses[held]
    return turned
