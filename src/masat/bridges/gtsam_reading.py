"""A graph from gtsam's factors and values."""

from __future__ import annotations

import contextlib
import warnings
from typing import Any

import numpy as np

from masat import lie
from masat.arrays import Floats
from masat.bridges.gtsam_landmarks import Seen, joined_observations, read_observation
from masat.bridges.gtsam_parts import pose_of
from masat.bridges.gtsam_priors import read_prior
from masat.errors import GraphError, MasatWarning
from masat.graph import PoseGraph
from masat.information import from_rotation_vectors
from masat.measurements import Priors

_LARGEST_ID = 2**63 - 2


class Found:
    """What was read of gtsam's factors.

    Parameters
    ----------
    gtsam : module
        The package.
    """

    def __init__(self, gtsam: Any) -> None:
        self._gtsam = gtsam
        self._between = {gtsam.BetweenFactorPose2: 2, gtsam.BetweenFactorPose3: 3}
        self._fixing = {gtsam.NonlinearEqualityPose2: 2, gtsam.NonlinearEqualityPose3: 3}
        self._edges: list[tuple[int, int]] = []
        self._measurements: list[Floats] = []
        self._information: list[Floats] = []
        self._priors: list[Priors] = []
        self._fixed: list[int] = []
        self._seen: list[Seen] = []
        self._losses = 0
        self._dimension = 0

    def add(self, k: int, factor: Any) -> None:
        """Take a factor by its number; one without a counterpart is a GraphError."""
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
            self._add_other(factor, name)

    def _add_other(self, factor: Any, name: str) -> None:
        def matrix() -> Floats:
            return self._matrix(factor, name)

        prior = read_prior(self._gtsam, factor, matrix)
        seen = read_observation(self._gtsam, factor, matrix)
        if prior is not None:
            self._take_dimension(prior.dimension, name)
            self._priors.append(prior)
        elif seen is not None:
            self._take_dimension(len(seen.measurement), name)
            self._seen.append(seen)
        else:
            raise GraphError(
                f"{name} of the keys {list(factor.keys())}, has no counterpart in this bridge: "
                "docs/bridges.md lists the factors that it reads"
            )

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
        """Return the graph of the factors and some values."""
        d = self._dimension
        if d == 0:
            raise GraphError("there is no factor of a pose graph")
        known = _poses(self._gtsam, values, d)
        points = _points(values, d, known)
        others = values.size() - len(known) - len(points)
        notes = []
        if self._losses:
            notes.append(
                f"the losses of {self._losses} factors are left out: masat.optimize(graph, loss=) "
                "takes one for all edges"
            )
        if others:
            notes.append(f"{others} values that are no Pose{d} and no Point{d} are left out")
        for note in notes:
            warnings.warn(note, MasatWarning, stacklevel=3)
        landmarks = joined_observations(self._seen, points, d)
        on_points = set() if landmarks is None else set(landmarks.ids.tolist())
        of_priors = {int(node) for prior in self._priors for node in prior.ids} - on_points
        of_edges = {end for ends in self._edges for end in ends}
        of_sights = {seen.ends[0] for seen in self._seen}
        ids = sorted(of_edges | of_priors | of_sights | known.keys() | set(self._fixed))
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
            landmarks=landmarks,
            notes=notes,
        )


def _poses(gtsam: Any, values: Any, d: int) -> dict[int, Floats]:
    """Return the poses among some values."""
    wanted = gtsam.utilities.allPose2s(values) if d == 2 else gtsam.utilities.allPose3s(values)
    at = wanted.atPose2 if d == 2 else wanted.atPose3
    return {int(key): pose_of(at(key)) for key in wanted.keys()}  # noqa: SIM118


def _points(values: Any, d: int, poses: dict[int, Floats]) -> dict[int, Floats]:
    """Return the points among some values."""
    at = values.atPoint2 if d == 2 else values.atPoint3
    found: dict[int, Floats] = {}
    for key in values.keys():  # noqa: SIM118
        if key not in poses:
            # gtsam tells the type of a value only by refusing the others.
            with contextlib.suppress(RuntimeError):
                found[int(key)] = np.asarray(at(key), np.float64)
    return found
