"""How far the other measurements of a map check each one."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from masat import _core, lie
from masat.arrays import Flags, Floats
from masat.assembly import AssembledGraph
from masat.covariance import change_of_frame, relative_covariances
from masat.graph import PoseGraph
from masat.residuals import range_bearing_by_position, residuals

# Added to what the others leave of a measurement's covariance, which may be nothing, as a fraction
# of it.
_LEAST_LEFT = 1e-9


class Whitened(NamedTuple):
    """Residuals of a map in units of their standard deviations.

    Attributes
    ----------
    residuals : ndarray, (m, d)
        Their squares add up to chi2. Directions without information have none.
    left : ndarray, (m, d, d)
        The covariance of the measurement less that of the map along it: what the others check. The
        identity where they determine the map by themselves; zero where nothing else does. Of a
        measurement that is not in the map, the sum of both.
    """

    residuals: Floats
    left: Floats

    def distances(self) -> Floats:
        """Return the squared distances of the measurements from what the others predict, (m,)."""
        e, d = self.residuals[..., None], self.residuals.shape[1]
        solved = np.linalg.solve(self.left + _LEAST_LEFT * np.eye(d), e)[..., 0]
        return np.asarray(np.einsum("ki,ki->k", self.residuals, solved))


def whitened(
    graph: PoseGraph,
    equations: _core.NormalEquations | None = None,
    *,
    absent: Flags | None = None,
) -> Whitened:
    """Return the residuals of each edge, and what the others check of them.

    With the whitened residual e of an edge and what is left, L, the measurement is e' L^-1 e from
    what the others predict: Baarda, A testing procedure for use in geodetic networks, 1968.

    Parameters
    ----------
    graph : PoseGraph
        A graph at its minimum.
    equations : NormalEquations, optional
        Those of the graph, to be used again.
    absent : ndarray of bool, (m,), optional
        Edges of the graph that are not in the equations, or hardly. Default: none.

    Raises
    ------
    OptimizationError
        If the edges do not determine some poses.
    """
    covariance = relative_covariances(graph, graph.edges, warn=False, equations=equations)
    offsets = graph.sensor_offsets
    if offsets is not None:
        at_sensor = change_of_frame(lie.inverse(offsets))
        covariance = at_sensor @ covariance @ at_sensor.swapaxes(-1, -2)
    e = residuals(graph)
    step = step_of_residual(e)
    if graph.range_bearing_edges is not None:
        edges, d = np.flatnonzero(graph.range_bearing_edges), graph.dimension
        step[edges, :d] = range_bearing_by_position(graph, edges) @ step[edges, :d]
    half = _root(graph)
    root = half @ step
    predicted = root @ covariance @ root.swapaxes(-1, -2)
    sign = 1.0 if absent is None else np.where(absent, -1.0, 1.0)[:, None, None]
    return Whitened((half @ e[..., None])[..., 0], np.eye(graph.dof) - sign * predicted)


def step_of_residual(e: Floats) -> Floats:
    """Return the derivatives of residuals by a step of the relative pose, (k, dof, dof)."""
    k, dof = e.shape
    out = np.zeros((k, dof, dof))
    d = 2 if dof == 3 else 3
    pose = np.zeros((k, lie.POSE_SIZE[d]))
    if d == 2:
        pose[:, 2] = e[:, 2]
        out[:, 2, 2] = 1
    else:
        vector = e[:, 3:]
        w = np.sqrt(np.maximum(1 - np.square(vector).sum(axis=1), 0))
        pose[:, 3:6], pose[:, 6] = vector, w
        out[:, 3:, 3:] = w[:, None, None] * np.eye(3)
        for i, j, axis in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            out[:, 3 + i, 3 + j] -= vector[:, axis]
            out[:, 3 + j, 3 + i] += vector[:, axis]
    out[:, :d, :d] = _core.rotation_matrices(pose)
    return out


def _root(graph: PoseGraph) -> Floats:
    """Return a matrix L with L' L = W for the information of each edge, (m, d, d)."""
    if not isinstance(graph, AssembledGraph):
        return np.asarray(np.linalg.cholesky(graph.information).swapaxes(-1, -2))
    values, axes = np.linalg.eigh(graph.information)
    root: Floats = np.sqrt(np.maximum(values, 0))[..., None] * axes.swapaxes(-1, -2)
    return root
