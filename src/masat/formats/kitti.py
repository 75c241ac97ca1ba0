"""The trajectories of the KITTI odometry benchmark: the upper three rows of 4x4 matrices.

A line has the 12 numbers of one pose, row by row, and no stamp. Source: Geiger, Lenz, Urtasun, Are
we ready for autonomous driving? The KITTI vision benchmark suite, CVPR 2012.
"""

from __future__ import annotations

import numpy as np

from masat import _core, lie
from masat.formats.table import Format, Kind, PoseText, Record
from masat.graph import PoseGraph


def format_graph(graph: PoseGraph) -> bytes:
    """Return the poses of a graph as the text of a trajectory, in the order of the ids."""
    assert graph.poses is not None
    poses = np.ascontiguousarray(lie.to_3d(graph.poses))
    rows = np.dstack([_core.rotation_matrices(poses), poses[:, :3, None]]).reshape(-1, 12)
    return _core.format_lines("", np.empty((len(rows), 0), np.int64), np.ascontiguousarray(rows))


FORMAT = Format(
    name="kitti",
    summary="KITTI: lines of 12 numbers, the upper three rows of a 4x4 matrix",
    records=(Record("", Kind.POSE, PoseText.MATRIX),),
    columns=(12,),
    format_graph=format_graph,
    suffixes=(".kitti",),
    needs=("poses",),
)
