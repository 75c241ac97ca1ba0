"""The chordal relaxation."""

from __future__ import annotations

import numpy as np

from masat import linear
from masat.graph import PoseGraph
from masat.initializers.roots import anchored, rooted
from masat.optimizers.translations import solve_translations


def chordal(graph: PoseGraph, root: int | None = None) -> PoseGraph:
    """Solve for all rotations at once as for free matrices, and then for all positions.

    Minimizes the weighted |R_j - R_i R|^2 over matrices, takes the nearest rotations, and then the
    positions that minimize chi2: two linear systems, whatever the noise. Sources: Martinec and
    Pajdla, Robust rotation and translation estimation in multiview reconstruction, CVPR 2007;
    Carlone, Tron, Daniilidis, Dellaert, Initialization techniques for 3D SLAM, ICRA 2015.
    """
    poses, notes = anchored(graph)
    form = linear.rotation_form(graph, linear.rotation_weights(graph))
    d, held = graph.dimension, graph.index(graph.gauge)
    # In 2D the second column is the first, turned: so is all that the system makes of it.
    columns = np.zeros((len(poses), d, 1 if d == 2 else d))
    columns[held] = linear.rotations(poses[held])[:, :, : columns.shape[2]]
    problem = linear.Minimizer(graph, form, columns)
    solved = problem(np.zeros_like(columns))
    if d == 2:
        a, b = solved[:, :, 0].T
        solved = np.array([[a, b], [-b, a]]).transpose(2, 1, 0)
    turned = linear.nearest_rotations(graph, poses, solved)
    return rooted(graph, solve_translations(graph, turned, problem.matrix), root, notes)
