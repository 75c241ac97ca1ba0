"""The translations that minimize chi2 at given rotations."""

from __future__ import annotations

from masat import _core
from masat.arrays import Floats
from masat.graph import PoseGraph
from masat.linear import undetermined


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
