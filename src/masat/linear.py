"""Linear least-squares problems on a graph, which the linear initial guesses solve.

A node's unknown is a matrix X (d, k). An edge from i to j adds the trace of
X_i' first X_i + 2 X_i' joint X_j + X_j' second X_j. Fixed and gauge-fixed nodes keep their values.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from masat import _core
from masat.arrays import Floats
from masat.errors import InitializationError
from masat.graph import PoseGraph


class EdgeBlocks(NamedTuple):
    """The blocks that the edges add to a quadratic form, (m, d, d) each."""

    first: Floats
    joint: Floats
    second: Floats


def rotation_blocks(measurements: Floats, weight: Floats) -> EdgeBlocks:
    """Return the blocks of weight |R_j - R_i R|^2, the unknowns being X_i = R_i'."""
    rotations = _core.rotation_matrices(measurements)
    same = weight[:, None, None] * np.eye(rotations.shape[1])
    return EdgeBlocks(same, -weight[:, None, None] * rotations, same)


class LinearProblem:
    """A quadratic form on a graph, factorized once and minimized for any linear term.

    Parameters
    ----------
    graph : PoseGraph
        The graph.
    blocks : EdgeBlocks
        What the edges add to the form.
    values : ndarray, (n, d, k)
        Values of the unknowns; those of the fixed and gauge-fixed nodes are kept.

    Raises
    ------
    InitializationError
        If the edges around a node do not determine it.
    """

    def __init__(self, graph: PoseGraph, blocks: EdgeBlocks, values: Floats) -> None:
        self._values = values
        self._free = graph.elimination.free_nodes()
        self.matrix = _core.GraphMatrix(graph.elimination, values.shape[1])
        self._from_fixed = self.matrix.assemble(graph.topology, *blocks, values)
        failed = self.matrix.factorize(np.zeros(self._from_fixed[..., 0].size))
        if failed >= 0:
            raise undetermined(graph, int(self._free[failed]))

    def solve(self, linear_term: Floats | None = None) -> Floats:
        """Return the unknowns X that minimize the form less the traces of 2 X_i' linear_term_i.

        Parameters
        ----------
        linear_term : ndarray, (n, d, k), optional
            Default: zero.

        Returns
        -------
        ndarray, (n, d, k)
        """
        rhs = self._from_fixed
        if linear_term is not None:
            rhs = rhs + linear_term[self._free]
        solution = self._values.copy()
        solution[self._free] = self.matrix.solve(rhs)
        return solution


def undetermined(graph: PoseGraph, node: int, what: str = "pose") -> InitializationError:
    """Return the error for a node, given by its index, that its edges do not determine."""
    return undetermined_node(int(graph.ids[node]), what)


def undetermined_node(node: int, what: str) -> InitializationError:
    """Return the error for a node, given by its id, that its edges do not determine."""
    return InitializationError(
        f"the edges around node {node} do not determine its {what}: masat.diagnose, or "
        "masat info, tells where information is nearly singular"
    )


def transposed_rotations(poses: Floats) -> Floats:
    """Return the unknowns X_i = R_i' of poses, (n, d, d)."""
    return np.ascontiguousarray(_core.rotation_matrices(poses).transpose(0, 2, 1))


def nearest_rotations(graph: PoseGraph, poses: Floats, unknowns: Floats) -> Floats:
    """Return poses with the rotations nearest to unknowns X_i = R_i', (n, d, d).

    Translations, and the poses of fixed and gauge-fixed nodes, are kept.
    """
    turned = _core.nearest_rotations(np.ascontiguousarray(unknowns.transpose(0, 2, 1)))
    turned[:, : graph.dimension] = poses[:, : graph.dimension]
    fixed = graph.index(graph.gauge)
    turned[fixed] = poses[fixed]
    return turned
