"""Linear approximation for graph optimization (LAGO)."""

from __future__ import annotations

import numpy as np

from masat import _core, lie, linear
from masat.arrays import Floats
from masat.errors import InitializationError
from masat.graph import PoseGraph
from masat.initializers.roots import rooted, roots_of
from masat.optimizers.translations import solve_translations

_TURN = 2 * np.pi


def lago(graph: PoseGraph, root: int | None = None) -> PoseGraph:
    """Solve for all headings at once as for numbers, and then for all positions; in 2D only.

    The headings along the breadth-first tree tell by how many turns each further measurement
    differs from the sum of its cycle; less these turns, all headings are one weighted linear
    least-squares problem. Then come the positions that minimize chi2. Two linear systems, whatever
    the noise, as long as it adds up to less than half a turn around each cycle of the tree.

    Sources: Carlone, Aragues, Castellanos, Bona, A fast and accurate approximation for planar pose
    graph optimization, IJRR 2014; the turns: Carlone, Censi, From angular manifolds to the integer
    lattice, T-RO 2014. Their second phase is a Gauss-Newton step in headings and positions; that
    of the positions alone costs less, and leaves to an optimizer the step that it takes anyway.
    """
    if graph.dimension != 2:
        raise InitializationError("lago is for planar graphs only: in 3D choose chordal")
    roots, poses, notes = roots_of(graph, None)
    poses, _ = _core.place_along_tree(
        graph.topology, roots, np.empty(0, np.bool_), graph.measurements, poses
    )
    turns = np.zeros_like(poses)
    turns[:, 2] = _corrections(graph, poses[:, 2])
    return rooted(graph, solve_translations(graph, lie.retract(poses, turns)), root, notes)


def _corrections(graph: PoseGraph, headings: Floats) -> Floats:
    """Return what to add to headings, (n,), so that they fit best."""
    start, end = graph.edge_indices.T
    misfit = graph.measurements[:, 2] - (headings[end] - headings[start])
    misfit -= _TURN * np.round(misfit / _TURN)
    weight = graph.information[:, 2, 2]
    block = weight[:, None, None]
    n = len(headings)
    force = weight * misfit
    pull = np.subtract(np.bincount(end, force, n), np.bincount(start, force, n))
    still = np.zeros((n, 1, 1))
    form = linear.Form(block, -block, block)
    return linear.Minimizer(graph, form, still)(pull.reshape(still.shape)).ravel()
