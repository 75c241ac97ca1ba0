"""The contents of the core's map as a graph."""

from __future__ import annotations

from typing import Any

import numpy as np

from masat import lie
from masat.arrays import Flags, Floats, Ids, Indices
from masat.graph import PoseGraph
from masat.online.sensor_rows import landmarks_of, priors_of, rows_of
from masat.residuals import as_poses


def graph_of(contents: dict[str, Any], hidden: Ids | None = None) -> PoseGraph:
    """Return the graph of a map's contents.

    Parameters
    ----------
    contents : dict
        Contents of the core's map.
    hidden : ndarray of int64, optional
        Ids of landmarks to leave out if nothing in the contents measures them.
    """
    ids, poses, is_point = contents["ids"], contents["poses"], contents["points"]
    size, rows = poses.shape[1], rows_of(contents)
    d = 2 if size == lie.POSE_SIZE[2] else 3
    shown = is_point
    if hidden is not None and len(hidden):
        shown = is_point & ~np.isin(ids, np.setdiff1d(hidden, rows["node"]))
    return PoseGraph.from_arrays(
        contents["edges"],
        contents["measurements"].reshape(-1, size),
        contents["information"],
        ids=ids[~is_point],
        poses=poses[~is_point],
        priors=priors_of(rows),
        landmarks=landmarks_of(rows, ids[shown], poses[shown, :d]),
    )


def poses_of_nodes(graph: PoseGraph, ids: Ids) -> Floats:
    """Return where poses and landmarks of a graph are, as poses, (n, 3) or (n, 7)."""
    assert graph.poses is not None
    out = np.tile(lie.identity(graph.dimension), (len(ids), 1))
    is_point = np.isin(ids, graph.point_ids)
    out[~is_point] = graph.poses[graph.index(ids[~is_point])]
    if is_point.any():
        assert graph.points is not None
        out[is_point] = as_poses(graph.points[np.searchsorted(graph.point_ids, ids[is_point])])
    return out


def roots_of(graph: PoseGraph, ids: Ids) -> Indices:
    """Return the fixed node of the component of each of a graph's ids, (n,).

    It is given by its index among these, which are in the order in which they were added: the first
    pose of the component, or the landmark that is alone in it; or -1 for the world if the component
    has priors.
    """
    components, tied = _components(graph, ids)
    is_point = np.isin(ids, graph.point_ids)
    # The poses come first, so that each component has the first of its poses.
    order = np.argsort(is_point, kind="stable")
    _, first, own = np.unique(components[order], return_index=True, return_inverse=True)
    roots = np.empty(len(ids), np.int64)
    roots[order] = order[first[own]]
    return np.where(tied, -1, roots).astype(np.int32)


def _components(graph: PoseGraph, ids: Ids) -> tuple[Indices, Flags]:
    """Return the component of each of a graph's ids, and whether it has priors."""
    if graph.priors is None and graph.landmarks is None:
        return graph.structure.components[graph.index(ids)], np.zeros(len(ids), np.bool_)
    joint = graph.joint_structure
    components = joint.components[joint.index(ids)]
    return components, np.asarray(components == joint.components[-1])
