"""A pose graph from arrays: the checks of each, and of whether they fit together."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from masat import _checks as checks
from masat import lie
from masat import stamps as times
from masat.arrays import Floats, Ids
from masat.errors import GraphError
from masat.measurements import Landmarks, Priors, joined, joined_landmarks

if TYPE_CHECKING:
    from masat.graph import PoseGraph


def from_arrays(
    cls: type[PoseGraph],
    edges: ArrayLike,
    measurements: ArrayLike,
    information: ArrayLike | None,
    *,
    ids: ArrayLike | None,
    poses: ArrayLike | None,
    fixed: int | Iterable[int],
    notes: Iterable[str],
    labels: ArrayLike | None,
    stamps: ArrayLike | None,
    priors: Priors | Iterable[Priors] | None,
    landmarks: Landmarks | Iterable[Landmarks | None] | None,
) -> PoseGraph:
    """See `PoseGraph.from_arrays`."""
    pairs = checks.pairs_of_ids(edges)
    all_priors, landmarks = joined(priors), joined_landmarks(landmarks)
    z = checks.table("measurements", measurements)
    given = None if poses is None else checks.table("poses", poses)
    if z.shape[1] == 0:
        z = z.reshape(0, _pose_size(given, all_priors, landmarks))
    if z.shape[1] not in (3, 7):
        raise GraphError(f"measurements must have shape (m, 3) or (m, 7), got {z.shape}")
    if len(pairs) != len(z):
        raise GraphError(f"{len(pairs)} edges but {len(z)} measurements")
    dof = lie.DOF[2 if z.shape[1] == 3 else 3]

    nodes = named_poses(pairs, all_priors, landmarks) if ids is None else checks.node_ids(ids)
    if len(nodes) == 0:
        raise GraphError("the graph is empty: it has no node")
    if given is not None and given.shape != (len(nodes), z.shape[1]):
        raise GraphError(
            f"poses must have shape ({len(nodes)}, {z.shape[1]}) to go with the ids and the "
            f"measurements, got {given.shape}"
        )
    z = checks.rotations(z, "measurement", pairs, "edge")
    if given is not None:
        given = checks.rotations(given, "pose", nodes, "node")
    stamped = times.node_stamps(stamps, nodes)
    if stamped is not None:
        stamped = stamped[np.argsort(nodes, kind="stable")]
    nodes, given = checks.ascending(nodes, given)
    checks.known_edges(nodes, pairs)
    fixed_ids = checks.row_of_integers("fixed", fixed)
    checks.known_nodes(nodes, fixed_ids, "fixed node")
    graph = cls(
        ids=nodes,
        poses=given,
        edges=pairs,
        measurements=z,
        information=checks.information_matrices(information, pairs, dof),
        fixed=fixed_ids,
        notes=tuple(notes),
        labels=checks.edge_labels(labels, len(pairs)),
        stamps=stamped,
    )
    if all_priors is not None or landmarks is not None:
        graph = graph.with_landmarks(landmarks).with_priors(all_priors)
    graph.structure.check_fixed(given)
    return graph


def named_poses(pairs: Ids, priors: Priors | None, landmarks: Landmarks | None) -> Ids:
    """Return the ids of the poses that edges, priors and observations name, ascending."""
    if priors is None and landmarks is None:
        return checks.distinct(pairs)
    named = [pairs.ravel()]
    if priors is not None:
        on_pose = np.ones(len(priors), np.bool_)
        if landmarks is not None:
            on_pose = ~np.isin(priors.ids, landmarks.ids)
        named.append(priors.ids[on_pose])
    if landmarks is not None:
        named.append(landmarks.observations[:, 0])
    return checks.distinct(np.concatenate(named))


def _pose_size(poses: Floats | None, priors: Priors | None, landmarks: Landmarks | None) -> int:
    """Return how many numbers a pose has where no edge tells it."""
    if poses is not None:
        return int(poses.shape[1])
    if priors is not None:
        return int(priors.measurements.shape[1])
    return 3 if landmarks is None else lie.POSE_SIZE[landmarks.dimension]
