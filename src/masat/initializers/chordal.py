"""The chordal relaxation."""

from __future__ import annotations

import numpy as np

from masat import linear
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
    blocks = linear.rotation_blocks(graph, rotation_weights(graph.information))
    d, fixed = graph.dimension, graph.index(graph.gauge)
    # In 2D the second column is the first one turned by 90 degrees, and so is all that follows.
    columns = np.zeros((len(poses), d, 1 if d == 2 else d))
    columns[fixed] = linear.transposed_rotations(poses[fixed])[:, :, : columns.shape[2]]
    problem = linear.LinearProblem(graph, blocks, columns)
    solved = problem.solve()
    if d == 2:
        a, b = solved[:, :, 0].T
        solved = np.array([[a, b], [-b, a]]).transpose(2, 1, 0)
    turned = linear.nearest_rotations(graph, poses, solved)
    return graph.with_poses(solve_translations(graph, turned, problem.matrix), notes=notes)
