"""Whether priors and landmarks fit a graph."""

from __future__ import annotations

import numpy as np

from masat import _checks as checks
from masat.arrays import Ids
from masat.errors import GraphError
from masat.measurements.landmarks import Landmarks
from masat.measurements.priors import Priors


def check_priors(priors: Priors, dimension: int, nodes: Ids, points: Ids) -> None:
    """Refuse priors of another dimension, on unknown nodes, or on the rotation of a point."""
    if priors.dimension != dimension:
        raise GraphError(f"the priors are in {priors.dimension}D but the graph is in {dimension}D")
    on_pose = checks.among(nodes, priors.ids)
    on_point = checks.among(points, priors.ids) if len(points) else np.zeros_like(on_pose)
    for k in np.flatnonzero(~(on_pose | on_point))[:1]:
        raise GraphError(
            f"a prior names node {priors.ids[k]}, which is not in the graph", node=int(k)
        )
    turned = priors.information[:, dimension:].any(axis=(1, 2))
    if priors.offsets is not None:
        turned |= (priors.offsets[:, :dimension] != 0).any(axis=1)
    for k in np.flatnonzero(on_point & turned)[:1]:
        raise GraphError(
            f"the prior of landmark {priors.ids[k]} measures a rotation or has an offset: a point "
            "has a position alone",
            node=int(k),
        )


def check_landmarks(landmarks: Landmarks, dimension: int, nodes: Ids) -> None:
    """Refuse landmarks of another dimension, with the id of a pose, or seen by unknown poses."""
    if landmarks.dimension != dimension:
        raise GraphError(
            f"the landmarks are in {landmarks.dimension}D but the graph is in {dimension}D"
        )
    for k in np.flatnonzero(checks.among(nodes, landmarks.ids))[:1]:
        raise GraphError(
            f"the id {landmarks.ids[k]} is that of a pose and of a landmark: choose another",
            node=int(k),
        )
    pairs = landmarks.observations
    for k in np.flatnonzero(~checks.among(nodes, pairs[:, 0]))[:1]:
        raise GraphError(
            f"observation {k} ({pairs[k, 0]} -> {pairs[k, 1]}) names pose {pairs[k, 0]}, which is "
            "not in the graph",
            edge=int(k),
        )
