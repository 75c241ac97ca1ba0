"""How sure a map is: covariances of its poses, alone and of one as seen from another."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from masat import lie
from masat.arrays import Floats, Ids
from masat.errors import GraphError, OptimizationError
from masat.graph import PoseGraph
from masat.optimizers.equations import normal_equations, why_singular


def covariances(graph: PoseGraph, ids: ArrayLike | None = None) -> Floats:
    """Return the marginal covariances of poses, given all measurements.

    They belong to the Gaussian of the linearized problem at the graph's poses, normally those of
    an optimum: blocks of the inverse of H = sum J' W J. The anchors hold still, their covariances
    are zero; other anchors (`fixed`) give other covariances.

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
        If the graph has no poses, or its edges leave some undetermined.

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
    places = graph.index(wanted)
    return _blocks(graph, places, places)


def relative_covariances(graph: PoseGraph, pairs: ArrayLike) -> Floats:
    """Return the covariances of poses as seen from others, whether an edge joins them or not.

    Unlike those of `covariances` they do not depend on the anchors, as long as these fix no more
    than the gauge.

    Parameters
    ----------
    graph : PoseGraph
        A graph with poses, as in `Result.graph`.
    pairs : array_like of int, (k, 2)
        Ids (a, b).

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
        If the graph has no poses, or its edges leave some undetermined.

    Notes
    -----
    Pairs that edges join cost as much as their marginals, others a solve along their nodes' paths
    to the root of the factor, shared by the pairs of one node (Kaess and Dellaert, Robotics and
    Autonomous Systems 2009).
    """
    places = graph.index(pairs)
    if places.size == 0:
        places = places.reshape(0, 2)
    if places.ndim != 2 or places.shape[1] != 2:
        raise GraphError(f"pairs must have shape (k, 2), got {places.shape}")
    a, b = places.T
    blocks = _blocks(graph, np.concatenate([a, b, a]), np.concatenate([a, b, b]))
    of_a, of_b, joint = blocks.reshape(3, len(a), graph.dof, graph.dof)
    assert graph.poses is not None
    turn = _derivative(lie.between(graph.poses[b], graph.poses[a]))
    # With (turn, 1) for the derivatives: in halves, so that the sum is symmetric to the last bit.
    half = of_b / 2 + turn @ (of_a @ _transposed(turn) / 2 + joint)
    return half + _transposed(half)


def _blocks(graph: PoseGraph, rows: Ids, columns: Ids) -> Floats:
    """Return blocks of the joint covariance, (k, d, d), by places of nodes in `graph.ids`."""
    if graph.poses is None:
        raise OptimizationError("the graph has no poses: give it some with masat.initialize")
    equations = normal_equations(graph)
    if not np.isfinite(equations.linearize(graph.poses)):
        raise OptimizationError("chi2 of the poses is not finite: they are too far apart")
    broken = equations.factorize(np.zeros_like(equations.rhs()))
    if broken >= 0:
        raise OptimizationError(why_singular(graph, broken))
    free = graph.elimination.free_nodes()
    place = np.full(len(graph.ids), -1, np.int32)
    place[free] = np.arange(len(free))
    inside = (place[rows] >= 0) & (place[columns] >= 0)
    blocks = np.zeros((len(rows), graph.dof, graph.dof))
    blocks[inside] = equations.inverse(place[rows[inside]], place[columns[inside]])
    return blocks


def _derivative(seen: Floats) -> Floats:
    """Return the derivative of a^-1 b by a step of a, (k, d, d); `seen` is a as seen from b.

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
