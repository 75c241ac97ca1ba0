"""The spectral relaxation."""

from __future__ import annotations

import numpy as np

from masat import _core, linear
from masat.arrays import Floats, Ids, Indices
from masat.graph import PoseGraph
from masat.information import rotation_weights
from masat.initializers.roots import gauge_poses
from masat.optimizers.translations import solve_translations

_MAX_STEPS = 100

# Vectors shorter by this factor are rounding; so are, squared, differences of nearly equal ones.
_LEAST = 1e-12
_INDEPENDENT = 1e-8


def spectral(graph: PoseGraph, *, tolerance: float = 1e-6) -> PoseGraph:
    """Take all rotations at once from eigenvectors, and then solve for all positions.

    Minimizes the weighted |R_j - R_i R|^2 over matrices as the chordal guess does. That one fixes a
    node and lets the matrices shrink far from it; here their columns are orthonormal over the whole
    component. Then come the nearest rotations, and the positions that minimize chi2.

    Parameters
    ----------
    graph : PoseGraph
        The graph.
    tolerance : float
        The eigenvectors are found when a step of inverse iteration turns the space that they span
        by a sine no greater. All steps share one factorization. Noise may concentrate the vectors:
        on 10kHog-man some nodes have 1e-5 of the mean, and 1e-4 is not enough.

    Returns
    -------
    PoseGraph
        The graph with poses. Where a component has several fixed nodes, the eigenvectors are the
        best of those that agree with the fixed nodes' rotations to each other.

    Notes
    -----
    Sources: Singer, Angular synchronization by eigenvectors and semidefinite programming, ACHA
    2011; Doherty, Rosen, Leonard, Performance guarantees for spectral initialization in rotation
    averaging and pose-graph SLAM, ICRA 2022.
    """
    _, poses, notes = gauge_poses(graph)
    known = linear.transposed_rotations(poses)
    laplacian = _Laplacian(graph, known)
    unknowns, turned = laplacian.lowest_vectors(tolerance)
    if turned > tolerance:
        notes.append(
            f"the eigenvectors were not found in {_MAX_STEPS} steps: the last still turned them "
            f"by {turned:.2g}"
        )
    for own, lead in zip(laplacian.nodes, laplacian.leads, strict=True):
        if np.count_nonzero(np.linalg.det(unknowns[own]) < 0) > len(own) / 2:
            unknowns[own, :, 0] *= -1
        fit = _core.nearest_rotations((unknowns[lead].T @ known[lead])[None])
        turn = _core.rotation_matrices(fit)[0]
        unknowns[own] = unknowns[own] @ turn
    guess = linear.nearest_rotations(graph, poses, unknowns)
    return graph.with_poses(solve_translations(graph, guess), notes=notes)


class _Laplacian:
    """The form weight |R_j - R_i R|^2 of vectors that the gauge nodes tie to the known ones.

    At the gauge nodes they are a multiple of the known ones. Tables of vectors are (n, d, k). Each
    component has vectors and a multiple of its own; with one gauge node any vectors will do.
    """

    def __init__(self, graph: PoseGraph, known: Floats) -> None:
        self._graph = graph
        self._known = known
        self._gauge = graph.index(graph.gauge)
        labels = graph.components[self._gauge]
        self.leads = self._gauge[np.unique(labels, return_index=True)[1]]
        self._lead = self.leads[labels]
        self._weight = rotation_weights(graph.information)
        self._back = _core.rotation_matrices(graph.measurements).transpose(0, 2, 1)
        self.nodes = _groups(graph.components)
        self._edges = _groups(graph.components[graph.edge_indices[:, 0]], len(self.nodes))

    def lowest_vectors(self, tolerance: float) -> tuple[Floats, float]:
        """Return the d orthonormal vectors of least energy, and by what sine the last step turned.

        Inverse iteration goes from X to inv(L) X, but L is singular without noise. With H, of least
        energy where the multiple is 1, inv(L) X inv(H'X) H'LH spans the same; its multiple is 1,
        and with the gauge nodes fixed the problem that it solves is regular. A step takes the best
        of the space of that, of X and of the X before. Source: Knyazev, Toward the optimal
        preconditioned eigensolver, SISC 2001.
        """
        blocks = linear.rotation_blocks(self._graph.measurements, self._weight)
        problem = linear.LinearProblem(self._graph, blocks, self._known)
        chordal = problem.solve()
        energies = self._energies(chordal)
        x = self._best(chordal)
        aside = np.zeros_like(x)
        rhs = np.empty_like(x)
        for _ in range(_MAX_STEPS):
            for own, energy in zip(self.nodes, energies, strict=True):
                inner = _product(chordal[own], x[own])
                rhs[own] = x[own] @ np.linalg.solve(inner, energy)
            step = problem.solve(rhs)
            for own in self.nodes:
                step[own] = step[own] @ np.linalg.inv(_product(x[own], step[own]))
            ahead = step - x  # and at right angles to x
            turned = max(_length(ahead[own]) / _length(step[own]) for own in self.nodes)
            if turned <= tolerance:
                break
            before, x = x, self._best(np.concatenate([x, ahead, aside], axis=2))
            for own in self.nodes:
                aside[own] = before[own] - x[own] @ _product(x[own], before[own])
        # Where vectors are small their neighbors agree after a step of inverse iteration only.
        return self._best(step), turned

    def _energies(self, vectors: Floats) -> list[Floats]:
        """Return X'LX, (k, k), for each component."""
        start, end = self._graph.edge_indices.T
        misfit = vectors[end] - self._back @ vectors[start]
        misfit *= np.sqrt(self._weight)[:, None, None]
        return [_product(misfit[own], misfit[own]) for own in self._edges]

    def _best(self, vectors: Floats) -> Floats:
        """Return the d orthonormal combinations of vectors that have the least energy."""
        d = vectors.shape[1]
        best = np.empty_like(vectors[..., :d])
        for own, energy in zip(self.nodes, self._energies(vectors), strict=True):
            basis = _orthonormal(_product(vectors[own], vectors[own]), d)
            _, lowest = np.linalg.eigh(basis.T @ energy @ basis)
            best[own] = vectors[own] @ (basis @ lowest[:, :d])
            # The basis of nearly dependent vectors is not exactly orthonormal.
            best[own] = best[own] @ _orthonormal(_product(best[own], best[own]), d)
        # Else rounding grows: away from one multiple there is less energy.
        multiple = self._known[self._lead].transpose(0, 2, 1) @ best[self._lead]
        best[self._gauge] = self._known[self._gauge] @ multiple
        return best


def _groups(labels: Indices, count: int = 0) -> list[Ids]:
    """Return the places of each label."""
    ends = np.cumsum(np.bincount(labels, minlength=count))
    return np.split(np.argsort(labels, kind="stable"), ends[:-1])


def _product(a: Floats, b: Floats) -> Floats:
    """Return a'b of two tables of vectors."""
    # Not by BLAS, whose threads cost more than they save here.
    product: Floats = np.einsum("nik,nil->kl", a, b)
    return product


def _length(vectors: Floats) -> float:
    return float(np.sqrt(np.einsum("nik,nik->", vectors, vectors)))


def _orthonormal(products: Floats, least: int) -> Floats:
    """Return orthonormal combinations, at least so many, of vectors with such products."""
    lengths = np.sqrt(np.diag(products))
    scale = np.zeros_like(lengths)
    np.divide(1, lengths, out=scale, where=lengths > _LEAST * lengths.max())
    s, u = np.linalg.eigh(products * np.outer(scale, scale))
    whole = s > _INDEPENDENT
    whole[-least:] = True
    combinations: Floats = scale[:, None] * u[:, whole] / np.sqrt(s[whole])
    return combinations
