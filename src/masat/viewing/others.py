"""What a view draws besides nodes and edges: priors, landmarks and the truth."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from masat import lie
from masat.arrays import AnyArray, Flags, Floats
from masat.errors import EvaluationError
from masat.evaluation.alignment import aligned
from masat.evaluation.matching import matched
from masat.graph import PoseGraph
from masat.viewing.payload import single

if TYPE_CHECKING:
    from masat.optimizers import Result

# Largest time between a pose and the true pose that belongs to it, in seconds, as in evo.
_MAX_DIFFERENCE = 0.01


def prior_arrays(graph: PoseGraph, result: Result | None, center: Floats) -> dict[str, AnyArray]:
    """Return the arrays of the payload for priors on poses.

    `fixes` are measured positions, NaN where a prior measures no position; those of a sensor with
    an offset are moved to where the node would be at its own orientation.
    """
    priors = graph.priors
    if priors is None:
        return {}
    rows = np.flatnonzero(np.isin(priors.ids, graph.ids))
    if len(rows) == 0:
        return {}
    d = graph.dimension
    assert graph.poses is not None
    nodes = graph.index(priors.ids[rows])
    fixes = priors.measurements[rows, :d] - center
    if priors.offsets is not None:
        sensors = lie.compose(graph.poses[nodes], priors.offsets[rows])
        fixes -= sensors[:, :d] - graph.poses[nodes, :d]
    measured = np.einsum("kii->ki", priors.information[rows])[:, :d] > 0
    fixes[~measured.all(axis=1)] = np.nan
    arrays: dict[str, AnyArray] = {
        "prior_nodes": nodes.astype(np.int32),
        "fixes": single(fixes),
        "prior_chi2": single(graph.chi2_per_prior[rows]),
    }
    kept = _kept_measurements(result, "prior", len(priors))
    if kept is not None:
        arrays["prior_kept"] = kept[rows]
    weights = None if result is None else result.prior_weights
    if weights is not None and len(weights) == len(priors):
        arrays["prior_weights"] = single(weights[rows])
    return arrays


def landmark_arrays(graph: PoseGraph, center: Floats) -> dict[str, AnyArray]:
    """Return the arrays of the payload for landmarks and their observations."""
    seen = graph.landmarks
    if seen is None or seen.positions is None:
        return {}
    ends = np.column_stack(
        [graph.index(seen.observations[:, 0]), np.searchsorted(seen.ids, seen.observations[:, 1])]
    )
    return {
        "landmark_ids": seen.ids,
        "landmarks": single(seen.positions - center),
        "observations": ends.astype(np.int32),
        "observation_chi2": single(graph.chi2_per_observation),
    }


def truth_arrays(
    graph: PoseGraph, truth: PoseGraph | None, center: Floats
) -> tuple[dict[str, AnyArray], dict[str, Any]]:
    """Return the true positions of the nodes, NaN where they are not known, moved onto the map.

    The motion minimizes the squared distances, as that of the ATE. Where the positions do not
    determine it, the first true pose is moved onto the first pose.
    """
    if truth is None:
        return {}, {}
    if truth.poses is None:
        raise EvaluationError("the truth has no poses")
    assert graph.poses is not None
    own, other, _ = matched(graph, truth, "auto", _MAX_DIFFERENCE)
    planar = graph.dimension == truth.dimension == 2
    map_poses, true_poses = lie.to_3d(graph.poses[own]), lie.to_3d(truth.poses[other])
    try:
        moved, _, _ = aligned(true_poses, map_poses, "se3", planar=planar)
    except EvaluationError:
        moved, _, _ = aligned(true_poses, map_poses, "origin", planar=planar)
    d = graph.dimension
    positions = np.full((len(graph), d), np.nan)
    positions[own] = moved[:, :d] - center
    distance = np.sqrt(np.square(moved[:, :d] - map_poses[:, :d]).sum(axis=1))
    rmse = float(np.sqrt(np.square(distance).mean()))
    return {"truth": single(positions)}, {"truth_rmse": rmse}


def _kept_measurements(result: Result | None, kind: str, count: int) -> Flags | None:
    """Return which priors were believed, if a robust solve judged as many."""
    if result is None or result.decision is None:
        return None
    table = result.decision.measurements
    own = table[table["kind"] == kind]
    if len(own) != count:
        return None
    kept = np.ones(count, np.bool_)
    kept[own["row"]] = own["kept"]
    return kept
