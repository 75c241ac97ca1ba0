"""Gaussian noise on the measurements of a graph."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from masat.errors import GraphError
from masat.graph import PoseGraph

ZERO_SIGMA = 1e-3
"""A sigma of 0 leaves a measurement exact; its information is that of this sigma."""


def perturb(graph: PoseGraph, sigma: Sequence[float], *, seed: int = 0) -> PoseGraph:
    """Add independent normal noise to x, y and theta of each planar measurement.

    Parameters
    ----------
    graph : PoseGraph
        A planar graph, the truth.
    sigma : sequence of float, (3,)
        Standard deviations of x, y (metres) and theta (radians).
    seed : int
        Of the random numbers.

    Returns
    -------
    PoseGraph
        The graph with noisy measurements, information diag(1 / sigma^2), and the poses of the
        truth. Where a sigma is 0, see `ZERO_SIGMA`.
    """
    deviations = np.asarray(sigma, np.float64)
    if graph.dimension != 2 or deviations.shape != (3,):
        raise GraphError("noise is for planar graphs and takes sigmas of x, y and theta")
    if not np.isfinite(deviations).all() or (deviations < 0).any():
        raise GraphError(f"sigmas must be finite and not negative, got {deviations.tolist()}")
    noise = np.random.default_rng(seed).normal(size=graph.measurements.shape)
    noisy = graph.measurements + deviations * noise
    noisy[:, 2] = (noisy[:, 2] + np.pi) % (2 * np.pi) - np.pi
    information = np.diag(1 / np.where(deviations > 0, deviations, ZERO_SIGMA) ** 2)
    return PoseGraph.from_arrays(
        graph.edges,
        noisy,
        information,
        ids=graph.ids,
        poses=graph.poses,
        fixed=graph.fixed.tolist(),
        notes=graph.notes,
    )
