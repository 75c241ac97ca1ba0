"""Gaussian noise on the measurements of a graph."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from masat.arrays import Floats
from masat.errors import GraphError
from masat.graph import PoseGraph
from masat.lie import compose
from masat.worlds.closures import check_seed

ZERO_SIGMA = 1e-3
"""A sigma of 0 leaves a measurement exact; its information is computed from this sigma instead."""


# The squares of larger ones, and of their inverses, come near the limits of a double.
_MAX_SIGMA = 1e100


def perturb(graph: PoseGraph, sigma: Sequence[float], *, seed: int = 0) -> PoseGraph:
    """Add independent normal noise to each measurement.

    The noise of the translation is added in the frame of the first pose. In 3D, the rotation q
    becomes q exp(noise), where the noise is a rotation vector.

    Parameters
    ----------
    graph : PoseGraph
        A graph with exact measurements.
    sigma : sequence of float
        Standard deviations in meters and radians. In 2D three: x, y, theta. In 3D two, that of x, y
        and z and that of the components of the rotation vector; or six: x, y, z, and the components
        of the rotation vector about x, y, z.
    seed : int
        Seed of the random numbers.

    Returns
    -------
    PoseGraph
        The graph with noisy measurements, diagonal information, and all else as it was: poses,
        labels, stamps, priors and landmarks. The information is 1 / sigma^2, for rotations in 3D
        4 / sigma^2, because the vector part of a quaternion is half the rotation vector. For a
        sigma of 0, see `ZERO_SIGMA`.

    Raises
    ------
    GraphError
        If the sigmas are not as many as the graph takes, or not finite, negative, or so large or
        small that their information is not a finite positive number; or if the seed is negative
        or not an integer.

    Notes
    -----
    g2o expresses the residual of the translation in the frame of the second pose. With unequal
    sigmas of x, y (and z), the information therefore fits the noise only where the rotation of the
    measurement is small.
    """
    try:
        given = np.asarray(sigma, np.float64)
    except (TypeError, ValueError):
        raise GraphError(f"sigmas must be numbers, got {sigma!r}") from None
    if graph.dimension == 3 and given.shape == (2,):
        given = np.repeat(given, 3)
    if given.shape != (graph.dof,):
        raise GraphError(
            "the noise of a 2D graph has 3 sigmas (x, y, theta), that of a 3D graph has 2 "
            "(translation, rotation) or 6 (x, y, z, and about x, y, z); got "
            f"{given.size} for {graph!r}"
        )
    if not np.isfinite(given).all() or (given < 0).any():
        raise GraphError(f"sigmas must be finite and not negative, got {given.tolist()}")
    if given.max() > _MAX_SIGMA or (given[given > 0] < 1 / _MAX_SIGMA).any():
        raise GraphError(
            f"sigmas must be 0 or between {1 / _MAX_SIGMA:g} and {_MAX_SIGMA:g}, got "
            f"{given.tolist()}"
        )
    check_seed(seed)
    noise = given * np.random.default_rng(seed).normal(size=(len(graph.edges), graph.dof))
    units = np.ones(3) if graph.dimension == 2 else np.repeat([1.0, 0.5], 3)
    spread = units * np.where(given > 0, given, ZERO_SIGMA)
    return PoseGraph.from_arrays(
        graph.edges,
        with_noise(graph.measurements, noise),
        np.diag(1 / spread**2),
        ids=graph.ids,
        poses=graph.poses,
        fixed=graph.fixed.tolist(),
        notes=graph.notes,
        labels=graph.labels,
        stamps=graph.stamps,
        priors=graph.priors,
        landmarks=graph.landmarks,
    )


def with_noise(measurements: Floats, noise: Floats) -> Floats:
    """Return measurements, (m, 3) or (m, 7), with this noise, (m, 3) or (m, 6); see `perturb`."""
    return (_planar if measurements.shape[1] == 3 else _spatial)(measurements, noise)


def _planar(measurements: Floats, noise: Floats) -> Floats:
    noisy: Floats = measurements + noise
    noisy[:, 2] = (noisy[:, 2] + np.pi) % (2 * np.pi) - np.pi
    return noisy


def _spatial(measurements: Floats, noise: Floats) -> Floats:
    rotations = np.zeros_like(measurements)
    half = np.linalg.norm(noise[:, 3:], axis=1, keepdims=True) / 2
    rotations[:, 3:6] = noise[:, 3:] / 2 * np.sinc(half / np.pi)
    rotations[:, 6:] = np.cos(half)
    noisy = compose(measurements, rotations)
    noisy[:, :3] += noise[:, :3]
    return noisy
