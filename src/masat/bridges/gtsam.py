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

import warnings
from typing import Any, NamedTuple

import numpy as np

from masat import lie
from masat.arrays import Floats
from masat.bridges.gtsam_parts import as_pose, noise_model, pose_of, singular
from masat.bridges.gtsam_priors import prior_factor, read_prior
from masat.bridges.packages import package, refuse, warn_left_out
from masat.errors import GraphError, MasatWarning
from masat.graph import PoseGraph
from masat.information import for_rotation_vectors, from_rotation_vectors
from masat.measurements import Priors

_LARGEST_ID = 2**63 - 2


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
    `PoseTranslationPrior` or a `PoseRotationPrior`, by what it measures.

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
        If gtsam cannot hold the graph: negative ids, landmarks, priors of a sensor that is not at
        the node, fixed nodes without poses; or edges that measure a translation and not the whole
        rotation, since gtsam's residual of the translation depends on it.
    MasatError
        If gtsam is not installed.
    """
    gtsam = package("gtsam", "gtsam")
    refuse(graph, "gtsam", "landmarks")
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
        _add_priors(gtsam, factors, graph.priors)
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
    found = _Read(gtsam)
    for k in range(factors.size()):
        factor = factors.at(k)
        if factor is not None:
            found.add(k, factor)
    return found.graph(gtsam.Values() if values is None else values)


class _Read:
    """What was read of gtsam's factors."""

    def __init__(self, gtsam: Any) -> None:
        self._gtsam = gtsam
        self._between = {gtsam.BetweenFactorPose2: 2, gtsam.BetweenFactorPose3: 3}
        self._fixing = {gtsam.NonlinearEqualityPose2: 2, gtsam.NonlinearEqualityPose3: 3}
        self._edges: list[tuple[int, int]] = []
        self._measurements: list[Floats] = []
        self._information: list[Floats] = []
        self._priors: list[Priors] = []
        self._fixed: list[int] = []
        self._losses = 0
        self._dimension = 0

    def add(self, k: int, factor: Any) -> None:
        kind = type(factor)
        name = f"factor {k}, a {kind.__name__}"
        for key in factor.keys():  # noqa: SIM118
            if key > _LARGEST_ID:
                raise GraphError(f"{name}, has the key {key}: ids are at most {_LARGEST_ID}")
        if kind in self._between:
            self._take_dimension(self._between[kind], name)
            a, b = factor.keys()
            self._edges.append((a, b))
            self._measurements.append(pose_of(factor.measured()))
            self._information.append(self._matrix(factor, name))
        elif kind in self._fixing:
            self._take_dimension(self._fixing[kind], name)
            self._fixed.append(factor.keys()[0])
        else:
            prior = read_prior(self._gtsam, factor, lambda: self._matrix(factor, name))
            if prior is None:
                raise GraphError(
                    f"{name} of the keys {list(factor.keys())}, has no counterpart in this bridge: "
                    "it reads BetweenFactor, PriorFactor, PoseTranslationPrior, PoseRotationPrior "
                    "and NonlinearEquality of Pose2 and Pose3"
                )
            self._take_dimension(prior.dimension, name)
            self._priors.append(prior)

    def _take_dimension(self, d: int, name: str) -> None:
        if self._dimension not in (0, d):
            raise GraphError(f"{name}, is in {d}D, but factors before it are not")
        self._dimension = d

    def _matrix(self, factor: Any, name: str) -> Floats:
        """Return the information of a factor in gtsam's order."""
        models, model = self._gtsam.noiseModel, factor.noiseModel()
        if isinstance(model, models.Robust):
            self._losses += 1
            model = model.noise()
        if model is None or model.isConstrained():
            raise GraphError(f"{name}, has no information: its noise model is constrained")
        return np.asarray(model.information(), np.float64)

    def graph(self, values: Any) -> PoseGraph:
        d = self._dimension
        if d == 0:
            raise GraphError("there is no factor of a pose graph")
        known, others = _poses(self._gtsam, values, d)
        notes = []
        if self._losses:
            notes.append(
                f"the losses of {self._losses} factors are left out: masat.optimize(graph, loss=) "
                "takes one for all edges"
            )
        if others:
            notes.append(f"{others} values that are no Pose{d} are left out")
        for note in notes:
            warnings.warn(note, MasatWarning, stacklevel=3)
        ids = sorted({*np.ravel(self._edges).tolist(), *self._fixed, *known})
        ids = sorted({*ids, *(int(i) for prior in self._priors for i in prior.ids)})
        for node in self._fixed:
            if node not in known:
                raise GraphError(f"node {node} is fixed, so its pose is needed in the values")
        return PoseGraph.from_arrays(
            np.array(self._edges, np.int64).reshape(-1, 2),
            np.array(self._measurements).reshape(-1, lie.POSE_SIZE[d]),
            from_rotation_vectors(np.array(self._information).reshape(-1, lie.DOF[d], lie.DOF[d])),
            ids=ids,
            poses=[known[node] for node in ids] if known and len(known) == len(ids) else None,
            fixed=self._fixed,
            priors=self._priors or None,
            notes=notes,
        )


def _poses(gtsam: Any, values: Any, d: int) -> tuple[dict[int, Floats], int]:
    """Return the poses among some values, and the number of the others."""
    wanted = gtsam.utilities.allPose2s(values) if d == 2 else gtsam.utilities.allPose3s(values)
    at = wanted.atPose2 if d == 2 else wanted.atPose3
    known = {int(key): pose_of(at(key)) for key in wanted.keys()}  # noqa: SIM118
    return known, values.size() - len(known)


def _check_rotations(information: Floats, d: int, name: Any) -> None:
    """Refuse information on a translation where the rotation is not all measured."""
    rotation = information[:, d:, d:]
    for k in np.flatnonzero(singular(rotation)):
        if information[k, :d, :d].any():
            raise GraphError(
                f"{name(k)} measures a translation and not the whole rotation: gtsam's residual of "
                "the translation depends on the rotation, so that its optimum would be another one"
            )


def _add_priors(gtsam: Any, factors: Any, priors: Priors) -> None:
    if priors.offsets is not None:
        raise GraphError(
            "gtsam cannot hold priors of a sensor that is not at the node (lever arms, offsets): "
            "remove them with graph.with_priors"
        )
    for k in range(len(priors)):
        factors.add(prior_factor(gtsam, priors, k))
