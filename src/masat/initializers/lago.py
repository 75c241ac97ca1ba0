"""Linear approximation for graph optimization (LAGO)."""

from __future__ import annotations

import numpy as np

from masat import _core, lie, linear
from masat.arrays import Floats
from masat.errors import InitializationError
from masat.graph import PoseGraph
from masat.initializers.roots import gauge_poses
from masat.optimizers.translations import solve_translations

_TURN = 2 * np.pi


def lago(graph: PoseGraph) -> PoseGraph:
    """Solve for all headings at once as numbers, then for all positions; 2D only.

    The headings along the breadth-first tree tell the winding number of the cycle that each further
    edge closes; with these multiples of 2 pi taken off, all headings are one weighted linear
    least-squares problem. Then come the positions that minimize chi2. Two linear systems, whatever
    the noise, as long as it adds up to less than half a turn around each cycle of the tree.

    Sources: Carlone, Aragues, Castellanos, Bona, A fast and accurate approximation for planar pose
    graph optimization, IJRR 2014; the winding numbers: Carlone, Censi, From angular manifolds to
    the integer lattice, T-RO 2014. Their second phase is a Gauss-Newton step in headings and
    positions; solving for the positions alone costs less, and leaves to an optimizer the step that
    it takes anyway.
    """
    if graph.dimension != 2:
        raise InitializationError("lago is for planar graphs only: in 3D choose chordal")
    roots, poses, notes = gauge_poses(graph)
    poses, _ = _core.place_along_tree(
        graph.topology, roots, np.empty(0, np.bool_), graph.measurements, poses
    )
    steps = np.zeros_like(poses)
    steps[:, 2] = _corrections(graph, poses[:, 2])
    return graph.with_poses(solve_translations(graph, lie.retract(poses, steps)), notes=notes)


def _corrections(graph: PoseGraph, headings: Floats) -> Floats:
    """Return what to add to headings, (n,), so that they fit best."""
    start, end = graph.edge_indices.T
    misfit = graph.measurements[:, 2] - (headings[end] - headings[start])
    misfit -= _TURN * np.round(misfit / _TURN)
    weight = graph.information[:, 2, 2]
    block = weight[:, None, None]
    n = len(headings)
    weighted = weight * misfit
    linear_term = np.subtract(np.bincount(end, weighted, n), np.bincount(start, weighted, n))
    zeros = np.zeros((n, 1, 1))
    problem = linear.LinearProblem(graph, linear.EdgeBlocks(block, -block, block), zeros)
    return problem.solve(linear_term.reshape(zeros.shape)).ravel()
