"""Costs that are quadratic in rotation matrices and translations, in the place of chi2.

A surrogate costs an edge from pose (R_i, t_i) to (R_j, t_j), that of a sensor where the edge
measures one,

    2 tr(A) - 2 <A, R' R_i' R_j> + tau |t_j - t_i - R_i t|^2,

with a measurement (R, t), a matrix A for the rotation, and a weight tau for the translation. For
A = kappa I the first part is kappa |R_j - R_i R|^2. The relaxation (`relaxation.py`) can bound
such a cost from below over all poses; chi2 itself it cannot.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from masat import _core
from masat.arrays import AnyArray, Flags, Floats
from masat.errors import OptimizationError
from masat.graph import PoseGraph
from masat.information import isotropic_weights
from masat.residuals import residuals

# A matrix whose smallest eigenvalue is below this fraction of its largest is singular to rounding.
_SINGULAR = 1e-14
# The least multiple of D that W may dominate: below it their coupling leaves no useful bound.
_MIN_RATIO = 1e-6
# What is taken off an eigenvalue so that rounding cannot make it too large.
_SLACK = 1e-12
# Radians: a minorant of the squared heading residual is not fitted nearer to half a turn than this.
_LARGEST_ANGLE = 0.99 * np.pi
# 1 - |vec(q)|: in 3D a residual nearer to half a turn than this has no usable minorant of its sine.
_LEAST_MARGIN = 1e-3


class Surrogate(NamedTuple):
    """A surrogate of chi2.

    Attributes
    ----------
    measurements : ndarray, (m, 3) or (m, 7)
        The (R, t) of each edge.
    rotation : ndarray, (m,), or (m, 3, 3) in 3D
        The kappa or the A of each edge.
    translation : ndarray, (m,)
        The tau of each edge.
    deficit : float
        Of a tangent surrogate: how far it lies below chi2 at the poses where it touches it.
    """

    measurements: Floats
    rotation: Floats
    translation: Floats
    deficit: float = 0.0


def chordal_surrogate(graph: PoseGraph) -> Surrogate:
    """Return the chordal cost, with isotropic weights that match chi2 for small residuals.

    In 3D it is chi2 itself if the information is isotropic; in 2D it counts 2 (1 - cos e) instead
    of e^2 for a heading residual e. Source: Rosen, Carlone, Bandeira, Leonard, SE-Sync, IJRR 2019.
    """
    weights = isotropic_weights(graph.information)
    return Surrogate(graph.measurements, weights.rotation, weights.translation)


def tangent_surrogate(graph: PoseGraph, poses: Floats) -> Surrogate:
    """Return a surrogate that, with a constant added, touches chi2 at poses and exceeds it nowhere.

    If the poses minimize the surrogate globally, they minimize chi2 globally. For each edge the
    information W is split into a part D that a surrogate can hold, lambda I for the translation
    and a block for the rotation, and a positive semidefinite rest P. By convexity
    e' P e >= 2 v' e - e*' P e* with v = P e*, e* being the residual at the poses; the linear term
    in the translation moves the measurement. What is left is rotation alone:

    - In 2D mu e^2 + 2 v e is a parabola about -v / mu. A cosine about the same heading that touches
      it at e* exceeds it nowhere: with u = e* + v / mu its amplitude is 2 mu u / sin u.
    - In 3D vec(q)' C vec(q) equals 2 tr(A) - 2 <A, R_e> with A = tr(C) / 8 I - C / 4, for any C.
      So that A is positive semidefinite, an eigenvalue of C above the sum of the two others is
      lowered to it; the rest is in P. The linear term b' vec(q), b = 2 v, is at least
      b' vec(q) (q*' q) - c (1 - (q*' q)^2) with c = |b| / (1 - |vec(q*)|), which is again linear in
      R_e.

    Parameters
    ----------
    graph : PoseGraph
        The graph.
    poses : ndarray, (n, 3) or (n, 7)
        Where to touch chi2.

    Returns
    -------
    Surrogate
        Its `deficit` is zero, but for residuals near half a turn and for strong coupling.

    Raises
    ------
    OptimizationError
        If an information matrix is singular to rounding where no surrogate is known.
    """
    e = residuals(graph, poses)
    part = _representable(graph)
    if graph.dimension == 2:
        return _planar(graph, e, part)
    return _spatial(graph, e, part)


class _Part(NamedTuple):
    """The D of each edge, and the P of those where there is one."""

    translation: Floats  # lambda, (m,)
    rotation: Floats  # (m,) in 2D, (m, 3, 3) in 3D
    mixed: AnyArray  # the edges with a P, (g,)
    rest: Floats  # their P, (g, dof, dof)


def _representable(graph: PoseGraph) -> _Part:
    d, w = graph.dimension, graph.information
    eye = np.eye(d)
    first = w[:, :1, :1]
    plain: Flags = (w[:, :d, :d] == first * eye).all(axis=(1, 2)) & ~w[:, :d, d:].any(axis=(1, 2))
    least = w[:, 0, 0].copy()
    blocks = w[:, d:, d:].copy()
    if d == 3:
        rows = np.abs(blocks).sum(axis=2).max(axis=1)
        steep = np.flatnonzero(2 * rows > np.einsum("kii->k", blocks))
        values, vectors = np.linalg.eigh(blocks[steep])
        high = values[:, 2] > values[:, 0] + values[:, 1]
        steep, values, vectors = steep[high], values[high], vectors[high]
        values[:, 2] = (values[:, 0] + values[:, 1]) * (1 - _SLACK)
        blocks[steep] = (vectors * values[:, None, :]) @ vectors.transpose(0, 2, 1)
        plain[steep] = False
    mixed = np.flatnonzero(~plain)
    own = w[mixed]
    spectrum = np.linalg.eigvalsh(own[:, :d, :d])
    turning = np.linalg.eigvalsh(blocks[mixed])
    # What measures nothing of the translation or of the rotation has no part to be split.
    alone = ~own[:, :d, d:].any(axis=(1, 2)) & (~w[mixed, d:, d:].any(axis=(1, 2)))
    alone |= ~own[:, :d].any(axis=(1, 2))
    singular = np.flatnonzero(
        (spectrum[:, 0] <= _SINGULAR * spectrum[:, -1]) & own[:, :d].any(axis=(1, 2))
        | (turning[:, 0] <= _SINGULAR * turning[:, -1]) & ~alone
    )
    if len(singular):
        a, b = graph.edges[mixed[singular[0]]]
        raise OptimizationError(
            f"the information of edge {a} -> {b} is singular to rounding: no bound on chi2"
        )
    lowest = (1 - _SLACK) * spectrum[:, 0] - 4 * np.finfo(np.float64).eps * spectrum[:, -1]
    held = np.zeros_like(own)
    held[:, range(d), range(d)] = lowest[:, None]
    held[:, d:, d:] = blocks[mixed]
    # The largest multiple of D that W dominates: below one only if W couples the two.
    split = held.copy()
    split[alone] = own[alone] = np.eye(w.shape[1])
    inverse_root = np.linalg.inv(np.linalg.cholesky(split))
    ratios = np.linalg.eigvalsh(inverse_root @ own @ inverse_root.transpose(0, 2, 1))
    own = w[mixed]
    # An eigenvalue is known to the rounding of the largest one.
    ratio = ratios[:, 0] - 16 * np.finfo(np.float64).eps * ratios[:, -1]
    if (ratio <= _MIN_RATIO).any():
        a, b = graph.edges[mixed[int(np.argmin(ratio))]]
        raise OptimizationError(
            f"the information of edge {a} -> {b} is singular to rounding: no bound on chi2"
        )
    held *= np.minimum(ratio * (1 - _SLACK), 1.0)[:, None, None]
    least[mixed], blocks[mixed] = held[:, 0, 0], held[:, d:, d:]
    return _Part(least, blocks[:, 0, 0] if d == 2 else blocks, mixed, own - held)


def _planar(graph: PoseGraph, e: Floats, part: _Part) -> Surrogate:
    mu, center = part.rotation, np.zeros(len(e))
    rest = part.rest.copy()
    # A prior of a position alone has neither.
    turned = np.where(mu > 0, mu, 1.0)[part.mixed]
    center[part.mixed] = -np.einsum("kj,kj->k", rest[:, 2], e[part.mixed]) / turned
    # Too far from the heading: without its part of P, which then has a bound of its own.
    far = np.abs(e[part.mixed, 2] - center[part.mixed]) > _LARGEST_ANGLE
    center[part.mixed[far]] = 0
    lost = _rest_cost(e[part.mixed][far], rest[far])
    rest[far] = _without_rotation(rest[far], 2)
    lost -= _rest_cost(e[part.mixed][far], rest[far])
    u = e[:, 2] - center
    touching = np.clip(u, -_LARGEST_ANGLE, _LARGEST_ANGLE)
    stretch = 1 / np.sinc(touching / np.pi)
    beyond = np.abs(u) > _LARGEST_ANGLE
    below = mu * (
        u**2 - touching**2 - 4 * stretch * (np.sin(u / 2) ** 2 - np.sin(touching / 2) ** 2)
    )
    z = _moved(graph, e, part, rest)
    z[:, 2] += center
    return Surrogate(z, stretch * mu / 2, part.translation, lost + float(below[beyond].sum()))


def _spatial(graph: PoseGraph, e: Floats, part: _Part) -> Surrogate:
    c = part.rotation
    a = np.einsum("kii->k", c)[:, None, None] / 8 * np.eye(3) - c / 4
    rest = part.rest.copy()
    q = e[part.mixed, 3:]
    margin = 1 - np.sqrt(np.square(q).sum(axis=1))
    far = margin < _LEAST_MARGIN
    lost = _rest_cost(e[part.mixed][far], rest[far])
    rest[far] = _without_rotation(rest[far], 3)
    lost -= _rest_cost(e[part.mixed][far], rest[far])
    b = 2 * np.einsum("kij,kj->ki", rest[:, 3:], e[part.mixed])
    a[part.mixed] -= _linear_in_rotation(b, q, np.maximum(margin, _LEAST_MARGIN)) / 2
    return Surrogate(_moved(graph, e, part, rest), a, part.translation, lost)


def _rest_cost(e: Floats, rest: Floats) -> float:
    return float(np.einsum("ki,kij,kj->", e, rest, e))


def _moved(graph: PoseGraph, e: Floats, part: _Part, rest: Floats) -> Floats:
    """Return the measurements, moved by the linear terms in the translations."""
    d, z = graph.dimension, graph.measurements.copy()
    v = np.einsum("kij,kj->ki", rest[:, :d], e[part.mixed])
    turn = _core.rotation_matrices(np.ascontiguousarray(z[part.mixed]))
    least = part.translation[part.mixed, None]
    z[part.mixed, :d] -= np.einsum("kij,kj->ki", turn, v) / np.where(least > 0, least, 1.0)
    return z


def _without_rotation(rest: Floats, d: int) -> Floats:
    """Return what is left of P for the best rotation: its Schur complement."""
    out = np.zeros_like(rest)
    coupling = rest[:, :d, d:]
    inverse = np.linalg.pinv(rest[:, d:, d:], hermitian=True)
    out[:, :d, :d] = rest[:, :d, :d] - coupling @ inverse @ coupling.transpose(0, 2, 1)
    return out


def _linear_in_rotation(b: Floats, q: Floats, margin: Floats) -> Floats:
    """Return the G of a minorant constant + <G, R_e> of b' vec(q) that touches it at q, (g, 3, 3).

    The minorant is a quadratic form Q' T Q in the whole unit quaternion Q = (w, q), whose products
    are linear in the rotation matrix.
    """
    w = np.sqrt(np.maximum(1 - np.square(q).sum(axis=1), 0))
    whole, slope = np.column_stack([w, q]), np.column_stack([np.zeros(len(b)), b])
    penalty = np.sqrt(np.square(b).sum(axis=1)) / margin
    t = (slope[:, :, None] * whole[:, None] + whole[:, :, None] * slope[:, None]) / 2
    t += penalty[:, None, None] * whole[:, :, None] * whole[:, None]
    vector = t[:, 1:, 1:]
    scale = t[:, 0, 0] - np.einsum("kii->k", vector)
    g: Floats = scale[:, None, None] / 4 * np.eye(3) + vector / 2
    for k, (i, j) in enumerate(((2, 1), (0, 2), (1, 0))):
        g[:, i, j] += t[:, 0, k + 1] / 2
        g[:, j, i] -= t[:, 0, k + 1] / 2
    return g
