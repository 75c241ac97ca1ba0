"""The chordal relaxation."""

from __future__ import annotations

import numpy as np

from masat import linear
from masat.arrays import Floats, Ids
from masat.graph import PoseGraph
from masat.information import rotation_weights
from masat.initializers.roots import gauge_poses
from masat.optimizers.translations import solve_translations


def chordal(graph: PoseGraph) -> PoseGraph:
    """Solve for all rotations at once as free matrices, then for all positions.

    Minimizes the weighted |R_j - R_i R|^2 over matrices, takes the nearest rotations, and then the
    positions that minimize chi2: two linear systems, whatever the noise. Sources: Martinec and
    Pajdla, Robust rotation and translation estimation in multiview reconstruction, CVPR 2007;
    Carlone, Tron, Daniilidis, Dellaert, Initialization techniques for 3D SLAM, ICRA 2015.
    """
    _, poses, notes = gauge_poses(graph)
    blocks = linear.rotation_blocks(graph.measurements, rotation_weights(graph.information))
    problem = linear.LinearProblem(graph, blocks, columns_of(poses, graph.index(graph.gauge)))
    turned = linear.nearest_rotations(graph, poses, square(problem.solve()))
    return graph.with_poses(solve_translations(graph, turned, problem.matrix), notes=notes)


def columns_of(poses: Floats, fixed: Ids) -> Floats:
    """Return the unknowns, (n, d, k), with the values of fixed nodes, given by their indices.

    In 2D one column is enough: the second is the first one turned by 90 degrees, and so is all that
    follows.
    """
    d = 2 if poses.shape[1] == 3 else 3
    columns = np.zeros((len(poses), d, 1 if d == 2 else d))
    columns[fixed] = linear.transposed_rotations(poses[fixed])[:, :, : columns.shape[2]]
    return columns


def square(columns: Floats) -> Floats:
    """Return the unknowns, (n, d, k), with all their columns, (n, d, d)."""
    if columns.shape[1] == 3:
        return columns
    a, b = columns[:, :, 0].T
    return np.array([[a, b], [-b, a]]).transpose(2, 1, 0)
