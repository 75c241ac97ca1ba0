"""gtsam: factors and values of a pose graph, both ways.

gtsam measures residuals by the logarithm of the pose, and its tangent vectors have the rotation
first in 3D: the rotation vector, then the translation. In 2D they are x, y, theta, as here. masat
and g2o take the translation of the pose itself, and in 3D the vector part of the quaternion, which
is half the rotation vector. So information changes its order and scale in 3D (see
`masat.information.for_rotation_vectors`), and chi2 agrees to first order in the residuals: it is
the same where all rotations fit, and the optima differ a little where they do not. gtsam's `error`
is half of chi2. gtsam's own reader of g2o files does not change the scale, so that its rotations
have four times the information of those here.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from masat.arrays import Floats, Ids
from masat.bridges.gtsam_landmarks import (
    observation_factors,
)
from masat.bridges.gtsam_parts import as_pose, noise_model, singular
from masat.bridges.gtsam_priors import prior_factor
from masat.bridges.gtsam_reading import Found
from masat.bridges.packages import package, warn_left_out
from masat.errors import GraphError
from masat.graph import PoseGraph
from masat.information import for_rotation_vectors
from masat.measurements import Landmarks, Priors


class Factors(NamedTuple):
    """A graph of gtsam.

    Attributes
    ----------
    graph : gtsam.NonlinearFactorGraph
        The factors, those of the edges first and in their order.
    values : gtsam.Values
        The poses; empty if the graph has none.
    """

    graph: Any
    values: Any


def to_gtsam(graph: PoseGraph, *, fix_gauge: bool = False) -> Factors:
    """Return a graph as gtsam's factors and values.

    The keys are the ids. An edge becomes a `BetweenFactorPose2` or `BetweenFactorPose3`, a fixed
    node a `NonlinearEqualityPose2` or `3`. A prior becomes a `PriorFactorPose`, a
    `PoseTranslationPrior` or a `PoseRotationPrior`, by what it measures; an observation of a
    landmark a `BearingRangeFactor`, `RangeFactor` or `BearingFactor`.

    Parameters
    ----------
    graph : PoseGraph
        The graph.
    fix_gauge : bool
        Whether gauge-fixed nodes become fixed nodes too. Without any, gtsam's optimizers stop with
        an indeterminate system. Needs poses.

    Returns
    -------
    Factors

    Raises
    ------
    GraphError
        If gtsam cannot hold the graph: negative ids, priors of a sensor that is not at the node,
        fixed nodes without poses, landmarks of which positions were measured; or edges that measure
        a translation and not the whole rotation, since gtsam's residual of the translation depends
        on it.
    MasatError
        If gtsam is not installed.
    """
    gtsam = package("gtsam", "gtsam")
    warn_left_out(graph, "gtsam", "stamps", "labels")
    if graph.ids[0] < 0:
        raise GraphError(
            f"gtsam's keys are not negative, but there is a node {graph.ids[0]}: use graph.relabel"
        )
    d = graph.dimension
    _check_rotations(graph.information, d, lambda k: "edge {} -> {}".format(*graph.edges[k]))
    between = gtsam.BetweenFactorPose2 if d == 2 else gtsam.BetweenFactorPose3
    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    information = for_rotation_vectors(graph.information)
    for k, (a, b) in enumerate(graph.edges.tolist()):
        noise = noise_model(gtsam, information[k])
        factors.add(between(a, b, as_pose(gtsam, graph.measurements[k]), noise))
    if graph.priors is not None:
        _add_priors(gtsam, factors, graph.priors, graph.point_ids)
    if graph.landmarks is not None:
        _add_landmarks(gtsam, factors, values, graph.landmarks)
    if graph.poses is not None:
        for node, pose in zip(graph.ids.tolist(), graph.poses, strict=True):
            values.insert(node, as_pose(gtsam, pose))
    equality = gtsam.NonlinearEqualityPose2 if d == 2 else gtsam.NonlinearEqualityPose3
    for node in (graph.gauge if fix_gauge else graph.fixed).tolist():
        if graph.poses is None:
            raise GraphError(
                f"node {node} cannot be fixed in gtsam without a pose: give the graph poses with "
                "masat.initialize"
            )
        factors.add(equality(node, as_pose(gtsam, graph.poses[graph.index(node)])))
    return Factors(factors, values)


def from_gtsam(factors: Any, values: Any = None) -> PoseGraph:
    """Return gtsam's factors and values as a graph.

    Parameters
    ----------
    factors : gtsam.NonlinearFactorGraph
        Factors of the types that `to_gtsam` writes.
    values : gtsam.Values, optional
        Poses. If some nodes have none, the graph has none. Needed for `NonlinearEquality`.

    Returns
    -------
    PoseGraph
        Its notes say what was left out: the losses of robust noise models, which
        `masat.optimize(graph, loss=...)` takes, and values of other types. Each is also a
        `MasatWarning`.

    Raises
    ------
    GraphError
        If a factor has another type, or if its noise model is constrained. It names the factor.
    MasatError
        If gtsam is not installed.
    """
    gtsam = package("gtsam", "gtsam")
    found = Found(gtsam)
    for k in range(factors.size()):
        factor = factors.at(k)
        if factor is not None:
            found.add(k, factor)
    return found.graph(gtsam.Values() if values is None else values)


def _check_rotations(information: Floats, d: int, name: Any) -> None:
    """Refuse information on a translation where the rotation is not all measured."""
    rotation = information[:, d:, d:]
    for k in np.flatnonzero(singular(rotation)):
        if information[k, :d, :d].any():
            raise GraphError(
                f"{name(k)} measures a translation and not the whole rotation: gtsam's residual of "
                "the translation depends on the rotation, so that its optimum would be another one"
            )


def _add_priors(gtsam: Any, factors: Any, priors: Priors, points: Ids) -> None:
    if priors.offsets is not None:
        raise GraphError(
            "gtsam cannot hold priors of a sensor that is not at the node (lever arms, offsets): "
            "remove them with graph.with_priors"
        )
    on_point = np.isin(priors.ids, points)
    for k in range(len(priors)):
        factors.add(prior_factor(gtsam, priors, k, on_point=bool(on_point[k])))


def _add_landmarks(gtsam: Any, factors: Any, values: Any, seen: Landmarks) -> None:
    if seen.ids.min(initial=0) < 0:
        raise GraphError(f"gtsam's keys are not negative, but there is a landmark {seen.ids[0]}")
    for factor in observation_factors(gtsam, seen):
        factors.add(factor)
    if seen.positions is not None:
        for point, position in zip(seen.ids.tolist(), seen.positions, strict=True):
            values.insert(point, position)
        return
    for point in np.setdiff1d(seen.ids, seen.observations[:, 1])[:1]:
        raise GraphError(
            f"gtsam cannot hold landmark {point}: it has no position and no observation"
        )
