"""gtsam's factors of priors."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from masat import lie
from masat.arrays import Floats
from masat.bridges.gtsam_parts import as_pose, noise_model, pose_of, rotation_of, singular
from masat.errors import GraphError
from masat.information import for_rotation_vectors, from_rotation_vectors
from masat.measurements import Priors, pose_priors


def prior_factor(gtsam: Any, priors: Priors, k: int, *, on_point: bool) -> Any:
    """Return gtsam's factor of a prior.

    Parameters
    ----------
    gtsam : module
        The package.
    priors : Priors
        Priors without offsets.
    k : int
        The index of the prior.
    on_point : bool
        Whether it is on a landmark.
    """
    d, node = priors.dimension, int(priors.ids[k])
    z, w = priors.measurements[k], priors.information[k]
    at = as_pose(gtsam, z)
    if not w[d:].any():
        # In the axes of the world, to which gtsam's residual refers.
        turn = lie.to_matrices(z)[:d, :d]
        if on_point:
            kind = gtsam.PriorFactorPoint2 if d == 2 else gtsam.PriorFactorPoint3
            return kind(node, z[:d], noise_model(gtsam, turn @ w[:d, :d] @ turn.T))
        kind = gtsam.PoseTranslationPrior2D if d == 2 else gtsam.PoseTranslationPrior3D
        return kind(node, at, noise_model(gtsam, turn @ w[:d, :d] @ turn.T))
    if not w[:d].any():
        kind = gtsam.PoseRotationPrior2D if d == 2 else gtsam.PoseRotationPrior3D
        rotation = w[d:, d:] if d == 2 else w[d:, d:] / 4
        return kind(node, at, noise_model(gtsam, rotation))
    if singular(w[None, d:, d:])[0]:
        raise GraphError(
            f"the prior of node {node} measures a translation and not the whole rotation in one: "
            "gtsam has no such factor; give it as two priors"
        )
    kind = gtsam.PriorFactorPose2 if d == 2 else gtsam.PriorFactorPose3
    return kind(node, at, noise_model(gtsam, for_rotation_vectors(w)))


def read_prior(gtsam: Any, factor: Any, matrix: Callable[[], Floats]) -> Priors | None:
    """Return the prior of a factor, or None if the factor is none.

    Parameters
    ----------
    gtsam : module
        The package.
    factor : gtsam.Factor
        The factor.
    matrix : callable
        Returns its information in gtsam's order.
    """
    kind, nodes = type(factor), list(factor.keys())
    poses = {gtsam.PriorFactorPose2: 2, gtsam.PriorFactorPose3: 3}
    translations = {gtsam.PoseTranslationPrior2D: 2, gtsam.PoseTranslationPrior3D: 3}
    points = {gtsam.PriorFactorPoint2: 2, gtsam.PriorFactorPoint3: 3}
    rotations = {gtsam.PoseRotationPrior2D: 2, gtsam.PoseRotationPrior3D: 3}
    if kind in poses:
        z = pose_of(factor.prior())
        return pose_priors(nodes, z[None], from_rotation_vectors(matrix()[None]))
    d = translations.get(kind) or rotations.get(kind) or points.get(kind)
    if d is None:
        return None
    z, w = lie.identity(d), np.zeros((lie.DOF[d], lie.DOF[d]))
    if kind in translations:
        z[:d], w[:d, :d] = factor.measured(), matrix()
    elif kind in points:
        z[:d], w[:d, :d] = factor.prior(), matrix()
    else:
        z[d:] = rotation_of(factor.measured())
        w[d:, d:] = matrix() if d == 2 else 4 * matrix()
    return pose_priors(nodes, z[None], w[None])
