"""Gaussian noise on the measurements of a graph."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from masat.arrays import Floats
from masat.errors import GraphError
from masat.graph import PoseGraph
from masat.lie import compose

ZERO_SIGMA = 1e-3
"""A sigma of 0 leaves a measurement exact; its information is that of this sigma."""


def perturb(graph: PoseGraph, sigma: Sequence[float], *, seed: int = 0) -> PoseGraph:
    """Add independent normal noise to each measurement.

    Noise of the translation is added to it, in the frame of the first pose. In space, the rotation
    is followed by that of a rotation vector drawn: q exp(noise).

    Parameters
    ----------
    graph : PoseGraph
        The truth.
    sigma : sequence of float
        Standard deviations, meters and radians. In the plane (3,): x, y, theta. In space (2,):
        each of x, y, z, and each component of the rotation vector; or (6,): x, y, z, and the
        components of the rotation vector about x, y, z.
    seed : int
        Of the random numbers.

    Returns
    -------
    PoseGraph
        The graph with noisy measurements, diagonal information, and the poses of the truth. The
        information is 1 / sigma^2, for rotations in space 4 / sigma^2: the vector part of a
        quaternion is half the rotation vector. Where a sigma is 0, see `ZERO_SIGMA`.

    Notes
    -----
    g2o takes translation errors in the frame of the second pose: unequal sigmas of x, y (and z) fit
    their information only where the measurement turns by little.
    """
    given = np.asarray(sigma, np.float64)
    if graph.dimension == 3 and given.shape == (2,):
        given = np.repeat(given, 3)
    if given.shape != (graph.dof,):
        raise GraphError(
            "noise takes 3 sigmas on planar graphs (x, y, theta), on spatial ones 2 (translation, "
            f"rotation) or 6 (x, y, z, and about x, y, z); got {given.size} on {graph!r}"
        )
    if not np.isfinite(given).all() or (given < 0).any():
        raise GraphError(f"sigmas must be finite and not negative, got {given.tolist()}")
    if seed < 0:
        raise GraphError(f"a seed is not negative, got {seed}")
    noise = given * np.random.default_rng(seed).normal(size=(len(graph.edges), graph.dof))
    units = np.ones(3) if graph.dimension == 2 else np.repeat([1.0, 0.5], 3)
    spread = units * np.where(given > 0, given, ZERO_SIGMA)
    return PoseGraph.from_arrays(
        graph.edges,
        (_planar if graph.dimension == 2 else _spatial)(graph.measurements, noise),
        np.diag(1 / spread**2),
        ids=graph.ids,
        poses=graph.poses,
        fixed=graph.fixed.tolist(),
        notes=graph.notes,
    )


def _planar(measurements: Floats, noise: Floats) -> Floats:
    noisy: Floats = measurements + noise
    noisy[:, 2] = (noisy[:, 2] + np.pi) % (2 * np.pi) - np.pi
    return noisy


def _spatial(measurements: Floats, noise: Floats) -> Floats:
    turns = np.zeros_like(measurements)
    half = np.linalg.norm(noise[:, 3:], axis=1, keepdims=True) / 2
    turns[:, 3:6] = noise[:, 3:] / 2 * np.sinc(half / np.pi)
    turns[:, 6:] = np.cos(half)
    noisy = compose(measurements, turns)
    noisy[:, :3] += noise[:, :3]
    return noisy
