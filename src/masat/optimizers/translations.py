"""The translations that minimize chi2 at given rotations."""

from __future__ import annotations

import numpy as np

from masat import _core
from masat.arrays import Floats
from masat.graph import PoseGraph
from masat.linear import EdgeBlocks, LinearProblem, undetermined


def solve_translations(
    graph: PoseGraph, poses: Floats, matrix: _core.GraphMatrix | None = None
) -> Floats:
    """Return the poses with the translations that minimize chi2 at their rotations.

    chi2 is quadratic in the translations, so one linear solve with the full information matrices
    is exact. Source: Carlone, Tron, Daniilidis, Dellaert, Initialization techniques for 3D SLAM,
    ICRA 2015, section II.

    Parameters
    ----------
    graph : PoseGraph
        The graph; its fixed and gauge-fixed nodes keep their poses.
    poses : ndarray, (n, 3) or (n, 7)
        Poses whose rotations are kept.
    matrix : GraphMatrix, optional
        A matrix with blocks of d rows that is no longer needed; its memory is used again.

    Returns
    -------
    ndarray, (n, 3) or (n, 7)

    Raises
    ------
    InitializationError
        If the edges around a node do not determine its position.
    """
    if matrix is None:
        matrix = _core.GraphMatrix(graph.elimination, graph.dimension)
    solved, failed = _core.solve_translations(
        graph.topology,
        matrix,
        graph.measurements,
        graph.information,
        poses,
        graph.sensor_offsets,
    )
    if failed >= 0:
        raise undetermined(graph, failed, "position")
    return solved


class BestTranslations:
    """What `solve_translations` returns for any rotations of a graph.

    Where the information of all translations is isotropic and has nothing to do with rotations, the
    system is the same at all rotations, and is factorized once.

    Parameters
    ----------
    graph : PoseGraph
        A graph with poses; its fixed and gauge-fixed nodes keep their positions.

    Raises
    ------
    InitializationError
        If the edges around a node do not determine its position.
    """

    def __init__(self, graph: PoseGraph) -> None:
        d, information = graph.dimension, graph.information
        assert graph.poses is not None
        self._graph = graph
        self._weight = np.ascontiguousarray(information[:, 0, 0])
        isotropic = (
            graph.sensor_offsets is None
            and (self._weight > 0).all()
            and all((information[:, k, k] == self._weight).all() for k in range(1, d))
            and not any(information[:, k, k + 1 :].any() for k in range(d))
        )
        self._problem: LinearProblem | None = None
        if isotropic:
            block = self._weight[:, None, None]
            positions = np.ascontiguousarray(graph.poses[:, None, :d])
            self._problem = LinearProblem(graph, EdgeBlocks(block, -block, block), positions)
        else:
            self._matrix = _core.GraphMatrix(graph.elimination, d)

    def __call__(self, poses: Floats) -> Floats:
        """Return poses, (n, 3) or (n, 7), with the best translations for their rotations."""
        graph = self._graph
        if self._problem is None:
            return solve_translations(graph, poses, self._matrix)
        d = graph.dimension
        i, j = graph.edge_indices.T
        turns = _core.rotation_matrices(poses)[i]
        moves = graph.measurements[:, None, :d]
        pulls = self._weight * (turns * moves).sum(axis=2).T
        n = len(poses)
        term = [np.bincount(j, pull, n) - np.bincount(i, pull, n) for pull in pulls]
        out = poses.copy()
        out[:, :d] = self._problem.solve(np.stack(term, axis=-1)[:, None])[:, 0]
        return out
