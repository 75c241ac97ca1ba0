"""The uncertainty of a map: covariances of its poses, and of poses relative to others."""

from __future__ import annotations

import warnings

import numpy as np
from numpy.typing import ArrayLike

from masat import _core, lie
from masat.arrays import Floats, Ids
from masat.assembly import Assembly, assemble, needs_assembly
from masat.determinacy import refuse_undetermined
from masat.errors import GraphError, MasatWarning, OptimizationError
from masat.graph import PoseGraph
from masat.optimizers.equations import normal_equations, why_singular

_EPSILON = float(np.finfo(np.float64).eps)
# Relative error of the covariances above which a warning is due.
_DOUBTFUL_ERROR = 1e-4


def covariances(graph: PoseGraph, ids: ArrayLike | None = None) -> Floats:
    """Return the marginal covariances of poses, given all measurements.

    They belong to the Gaussian of the linearized problem at the graph's poses, normally those of
    an optimum: blocks of the inverse of H = sum J' W J. The nodes of `graph.gauge` have covariance
    zero, and other fixed nodes give other covariances.

    Parameters
    ----------
    graph : PoseGraph
        A graph with poses, as in `Result.graph`.
    ids : array_like of int, (k,), optional
        Ids of nodes. Default: all, in the order of `graph.ids`.

    Returns
    -------
    ndarray, (k, 3, 3) or (k, 6, 6)
        Covariance of the step that `masat.lie.retract` takes from the pose: x, y, theta, or
        translation and vector part of the quaternion (half the angle), in the node's own frame;
        meters and radians. g2o's order and scale, as in `graph.information`.

    Raises
    ------
    GraphError
        If an id is not in the graph.
    OptimizationError
        If the graph has no poses, or its edges do not determine some of them. Where the system is
        so nearly singular that they may have fewer than four correct digits, a `MasatWarning` says
        so.

    Notes
    -----
    Costs one factorization and about as much again, by the recursion of Erisman and Tinney (CACM
    1975) down the factor; for few nodes only along their paths to its root.

    gtsam has the rotation first, as a rotation vector, which is twice the quaternion's part::

        order, scale = [3, 4, 5, 0, 1, 2], np.array([2, 2, 2, 1, 1, 1])
        gtsam_covariances = c[:, order][:, :, order] * np.outer(scale, scale)
    """
    wanted = graph.ids if ids is None else np.asarray(ids)
    if wanted.ndim != 1:
        raise GraphError(f"ids must have shape (k,), got {wanted.shape}")
    indices = graph.index(wanted)
    return _blocks(graph, indices, indices, warn=True)


def landmark_covariances(graph: PoseGraph, ids: ArrayLike | None = None) -> Floats:
    """Return the marginal covariances of landmarks, given all measurements.

    Parameters
    ----------
    graph : PoseGraph
        A graph with poses and positions of its landmarks, as in `Result.graph`.
    ids : array_like of int, (k,), optional
        Ids of landmarks. Default: all, in the order of `graph.point_ids`.

    Returns
    -------
    ndarray, (k, 2, 2) or (k, 3, 3)
        In square meters, along the axes of the world.

    Raises
    ------
    GraphError
        If an id is that of no landmark.
    OptimizationError
        As `covariances`.
    """
    wanted = graph.point_ids if ids is None else np.asarray(ids)
    if wanted.ndim != 1:
        raise GraphError(f"ids must have shape (k,), got {wanted.shape}")
    for node in wanted[~np.isin(wanted, graph.point_ids)][:1]:
        raise GraphError(f"the graph has no landmark {node}")
    assembly = assemble(graph)
    indices = assembly.graph.index(wanted)
    d = graph.dimension
    return _blocks_of_assembly(assembly, indices, indices, warn=True)[:, :d, :d]


def relative_covariances(
    graph: PoseGraph,
    pairs: ArrayLike,
    *,
    warn: bool = True,
    equations: _core.NormalEquations | None = None,
) -> Floats:
    """Return the covariances of poses relative to others, whether an edge joins them or not.

    Unlike those of `covariances` they do not depend on the gauge-fixed nodes, if both nodes are in
    one component. Between components nothing is measured: the fixed nodes alone relate them.

    Parameters
    ----------
    graph : PoseGraph
        A graph with poses, as in `Result.graph`.
    pairs : array_like of int, (k, 2)
        Ids (a, b).
    warn : bool
        Whether to warn where the system is nearly singular.
    equations : NormalEquations, optional
        Those of a graph that differs in its poses alone, to be used again.

    Returns
    -------
    ndarray, (k, 3, 3) or (k, 6, 6)
        Covariance of a^-1 b: of the step from it, in the frame of b; order, units and scale as in
        `covariances`.

    Raises
    ------
    GraphError
        If an id is not in the graph.
    OptimizationError
        If the graph has no poses, or its edges do not determine some of them. Where the system is
        so nearly singular that they may have fewer than four correct digits, a `MasatWarning` says
        so.

    Notes
    -----
    Pairs that edges join cost as much as their marginals, others a solve along their nodes' paths
    to the root of the factor, shared by the pairs of one node (Kaess and Dellaert, Robotics and
    Autonomous Systems 2009).
    """
    indices = graph.index(pairs)
    if indices.size == 0:
        indices = indices.reshape(0, 2)
    if indices.ndim != 2 or indices.shape[1] != 2:
        raise GraphError(f"pairs must have shape (k, 2), got {indices.shape}")
    a, b = indices.T
    blocks = _blocks(graph, np.concatenate([a, b, a]), np.concatenate([a, b, b]), warn, equations)
    of_a, of_b, joint = blocks.reshape(3, len(a), graph.dof, graph.dof)
    assert graph.poses is not None
    return relative_from_blocks(of_a, of_b, joint, graph.poses[a], graph.poses[b])


def relative_from_blocks(of_a: Floats, of_b: Floats, joint: Floats, a: Floats, b: Floats) -> Floats:
    """Return covariances of a^-1 b, (k, d, d), from blocks of the joint one at the poses."""
    turn = change_of_frame(lie.between(b, a))
    # The derivatives are (turn, 1); summed in halves, so that the result is exactly symmetric.
    half = of_b / 2 + turn @ (of_a @ _transposed(turn) / 2 + joint)
    return half + _transposed(half)


def _blocks(
    graph: PoseGraph,
    rows: Ids,
    columns: Ids,
    warn: bool,
    equations: _core.NormalEquations | None = None,
) -> Floats:
    """Return blocks of the joint covariance, (k, d, d), by indices of nodes in `graph.ids`."""
    if graph.poses is None:
        raise OptimizationError("the graph has no poses: give it some with masat.initialize")
    if needs_assembly(graph):
        assembly = assemble(graph)
        at = assembly.poses_at
        return _blocks_of_assembly(assembly, at[rows], at[columns], warn)
    equations = equations or normal_equations(graph)
    if not np.isfinite(equations.linearize(graph.poses)):
        raise OptimizationError("chi2 of the poses is not finite: they are too far apart")
    failed = equations.factorize(np.zeros_like(equations.rhs()))
    if failed >= 0:
        raise OptimizationError(why_singular(graph, failed))
    if warn:
        _warn_if_doubtful(equations.pivot_ratio())
    free = graph.elimination.free_nodes()
    index = np.full(len(graph), -1, np.int32)
    index[free] = np.arange(len(free))
    inside = (index[rows] >= 0) & (index[columns] >= 0)
    blocks = np.zeros((len(rows), graph.dof, graph.dof))
    blocks[inside] = equations.inverse(index[rows[inside]], index[columns[inside]])
    return blocks


def _blocks_of_assembly(assembly: Assembly, rows: Ids, columns: Ids, warn: bool) -> Floats:
    """Return blocks of the joint covariance of poses and landmarks, by indices of all nodes."""
    if assembly.graph.poses is None:
        raise OptimizationError("the landmarks have no positions: solve the graph first")
    refuse_undetermined(assembly, "there are no covariances")
    return _blocks(assembly.graph, rows, columns, warn)


def _warn_if_doubtful(pivot_ratio: float) -> None:
    """Warn where rounding, times the condition that the smallest pivot shows, makes large errors.

    It is a bound: along chains of thousands of nodes the errors are smaller.
    """
    error = _EPSILON / pivot_ratio
    if error > _DOUBTFUL_ERROR:
        warnings.warn(
            f"the covariances may be wrong by a fraction of up to {min(error, 1):.1g}: the system "
            f"is nearly singular (condition about {1 / pivot_ratio:.1g}); masat.diagnose tells "
            "where information is nearly singular",
            MasatWarning,
            stacklevel=4,
        )


def change_of_frame(seen: Floats) -> Floats:
    """Return the derivative of a^-1 b by a step of a, (k, d, d), from the poses b^-1 a.

    It is minus the adjoint of b^-1 a.
    """
    count, dof = len(seen), lie.DOF[2 if seen.shape[1] == 3 else 3]
    n = 2 if dof == 3 else 3
    ahead = np.tile(lie.identity(n), (n, 1))
    ahead[:, :n] = np.eye(n)
    origin = seen[:, :n]
    # Columns are the axes of a in the frame of b.
    rotation = _transposed(lie.compose(seen[:, None], ahead)[..., :n] - origin[:, None])
    out = np.zeros((count, dof, dof))
    out[:, :n, :n] = -rotation
    if n == 2:
        out[:, 0, 2], out[:, 1, 2] = -origin[:, 1], origin[:, 0]
        out[:, 2, 2] = -1
    else:
        # The quaternion's part is half the rotation vector.
        out[:, :n, n:] = -2 * _transposed(np.cross(origin[:, None], _transposed(rotation)))
        out[:, n:, n:] = -rotation
    return out


def _transposed(matrices: Floats) -> Floats:
    return matrices.swapaxes(-1, -2)
