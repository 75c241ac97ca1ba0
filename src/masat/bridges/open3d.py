"""Open3D: its pose graph of 4x4 matrices, in 3D.

Open3D measures the pose of an edge's source in the frame of its target. So its source is the node
that an edge here leads to, and its target the one that it comes from: measurement, residual and
information are then those of the edge. Its tangent vectors have the rotation first, as a rotation
vector (see `masat.information.for_rotation_vectors`).

Source: Open3D, pipelines/registration/GlobalOptimization.cpp, `ComputeZeta`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from masat import _checks as checks
from masat import lie
from masat.arrays import Flags
from masat.bridges.packages import package, refuse, warn_left_out
from masat.chain import odometry_edges
from masat.errors import GraphError
from masat.graph import PoseGraph
from masat.information import for_rotation_vectors, from_rotation_vectors

CERTAIN, UNCERTAIN = "certain", "uncertain"
"""Labels of edges that Open3D believes in any case, and of those that it may reject."""


def to_open3d(graph: PoseGraph) -> Any:
    """Return a graph in 3D with poses as an `open3d.pipelines.registration.PoseGraph`.

    Open3D numbers nodes from 0: node k is `graph.ids[k]`. Loop closures are marked as uncertain,
    which Open3D's optimizer may reject; or the edges that have the label "uncertain", if all edges
    have it or "certain". A single fixed node is Open3D's `reference_node`, which it fixes at 0 by
    default.

    Parameters
    ----------
    graph : PoseGraph
        A graph in 3D with poses.

    Returns
    -------
    open3d.pipelines.registration.PoseGraph

    Raises
    ------
    GraphError
        If Open3D cannot hold the graph: one in 2D, without poses, with priors or landmarks, or with
        fixed nodes other than the first node alone.
    MasatError
        If Open3D is not installed.
    """
    registration = package("open3d", "open3d").pipelines.registration
    if graph.dimension != 3:
        raise GraphError("Open3D's pose graph is in 3D, and this graph is in 2D")
    if graph.poses is None:
        raise GraphError(
            "Open3D's nodes need poses: give the graph some with masat.initialize or masat.solve"
        )
    if len(graph.fixed) and graph.fixed.tolist() != graph.ids[:1].tolist():
        raise GraphError(
            f"Open3D has no fixed nodes in its graph, and this one has {graph.fixed.tolist()[:5]}: "
            "remove them with graph.with_fixed([]); its option reference_node fixes one"
        )
    refuse(graph, "Open3D", "priors", "landmarks")
    uncertain = _uncertain(graph)
    warn_left_out(graph, "Open3D", "stamps", *(() if _has_certainty(graph) else ("labels",)))
    out = registration.PoseGraph()
    for matrix in lie.to_matrices(graph.poses):
        out.nodes.append(registration.PoseGraphNode(matrix))
    transformations = lie.to_matrices(graph.measurements)
    information = for_rotation_vectors(graph.information)
    for k, (a, b) in enumerate(graph.edge_indices.tolist()):
        out.edges.append(
            registration.PoseGraphEdge(
                b, a, transformations[k], information[k], bool(uncertain[k]), 1.0
            )
        )
    return out


def from_open3d(pose_graph: Any, *, ids: ArrayLike | None = None) -> PoseGraph:
    """Return Open3D's pose graph as a graph.

    Parameters
    ----------
    pose_graph : open3d.pipelines.registration.PoseGraph
        The pose graph.
    ids : array_like of int, (n,), optional
        Ids of the nodes. Default: 0, 1, and so on.

    Returns
    -------
    PoseGraph
        The label of an edge is "certain" or "uncertain". Confidences, which Open3D's optimizer
        computes, are not read.

    Raises
    ------
    GraphError
        If matrices are no rotations with translations, or if the graph is not valid, as
        `PoseGraph.from_arrays` says.
    """
    nodes = range(len(pose_graph.nodes)) if ids is None else checks.node_ids(ids).tolist()
    if len(nodes) != len(pose_graph.nodes):
        raise GraphError(f"{len(nodes)} ids do not fit {len(pose_graph.nodes)} nodes of Open3D")
    edges = list(pose_graph.edges)
    for k, edge in enumerate(edges):
        for end in (edge.source_node_id, edge.target_node_id):
            if not 0 <= end < len(nodes):
                raise GraphError(f"edge {k} names the node {end} of {len(nodes)}", edge=k)
    matrices = np.array([edge.transformation for edge in edges]).reshape(-1, 4, 4)
    information = np.array([edge.information for edge in edges]).reshape(-1, 6, 6)
    labels = [UNCERTAIN if edge.uncertain else CERTAIN for edge in edges]
    return PoseGraph.from_arrays(
        np.array(
            [(nodes[edge.target_node_id], nodes[edge.source_node_id]) for edge in edges], np.int64
        ).reshape(-1, 2),
        lie.from_matrices(matrices),
        from_rotation_vectors(information),
        ids=list(nodes),
        poses=lie.from_matrices(np.array([node.pose for node in pose_graph.nodes])),
        labels=labels or None,
    )


def _has_certainty(graph: PoseGraph) -> bool:
    return graph.labels is not None and bool(np.isin(graph.labels, [CERTAIN, UNCERTAIN]).all())


def _uncertain(graph: PoseGraph) -> Flags:
    if _has_certainty(graph):
        return np.asarray(graph.labels == UNCERTAIN)
    return ~odometry_edges(graph)
