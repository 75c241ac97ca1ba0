"""How the parts of a map that grows lie to each other, and where its landmarks are."""

from __future__ import annotations

from typing import Any

import numpy as np

from masat import lie
from masat.arrays import AnyArray, Flags, Floats, Indices
from masat.assembly import assemble
from masat.covariance import covariances
from masat.errors import OptimizationError
from masat.freedoms import body_of_each_node, undetermined
from masat.graph import PoseGraph
from masat.initializers.odometry import odometry
from masat.initializers.placing import placed_assembly
from masat.initializers.triangulation import triangulated
from masat.measurements import Priors
from masat.online.contents import graph_of
from masat.online.sensor_rows import landmarks_of, places, rows_of, with_rows
from masat.optimizers import optimize
from masat.residuals import as_poses
from masat.structure import Structure

# Standard deviation of the rotation of a part, in radians, up to which its pose is known well
# enough to go on from there by Gauss-Newton; and of the position of a landmark, as a fraction of
# its distance.
_MAX_ANGLE, _MAX_SPREAD = 0.2, 0.3
# Information of the relative poses of a part, as a multiple of that of what measures it: it is
# moved as a whole.
_STIFFNESS = 1e3
_MAX_ROUNDS = 20


def motion_of_part(poses: Floats, rows: AnyArray, ends: Indices, is_moved: Flags) -> Floats | None:
    """Return the motion of a rigid part onto what rows say of it, or None if they leave it open.

    Parameters
    ----------
    poses : ndarray, (n, 3) or (n, 7)
        Poses of all nodes of the core, landmarks and the world among them.
    rows : structured ndarray, (k,)
        Priors and observations that join the part to the world, or to another part.
    ends : ndarray of int32, (k, 2)
        Indices of the nodes of each row.
    is_moved : ndarray of bool, (n,)
        Which nodes are those of the part.
    """
    chosen = rows["is_prior"] | places(rows)
    if not chosen.any():
        return None
    return _motion(poses, *_as_priors(poses, rows[chosen], ends[chosen], is_moved))


def _as_priors(
    poses: Floats, rows: AnyArray, ends: Indices, is_moved: Flags
) -> tuple[Indices, Priors]:
    """Return the nodes of a part that rows measure, and priors in the frame of the other part.

    Observations have the least of their information in all directions: the rotation of the part is
    not known yet.
    """
    d = 2 if poses.shape[1] == 3 else 3
    from_part = is_moved[ends[:, 0]]
    seen, nodes = ~rows["is_prior"], np.where(from_part, ends[:, 0], ends[:, 1])
    z, w, offsets = rows["measurement"].copy(), rows["information"].copy(), rows["offset"].copy()
    other = lie.compose(poses[ends[:, 0]], z)
    other[from_part] = poses[ends[from_part, 1]]
    z[seen] = as_poses(other[seen, :d])
    offsets[from_part] = as_poses(rows["measurement"][from_part, :d])
    diagonal = np.linalg.eigvalsh(w[:, :d, :d])[:, 0]
    polar = rows["range_bearing"]
    squared = np.square(rows["measurement"][polar, :d]).sum(axis=1)
    least = np.linalg.eigvalsh(w[polar, 1:d, 1:d])[:, 0]
    squared = np.maximum(squared, 1 / w[polar, 0, 0])
    diagonal[polar] = np.minimum(w[polar, 0, 0], least / squared)
    w[seen] = 0
    w[seen, :d, :d] = diagonal[seen, None, None] * np.eye(d)
    return nodes, Priors(nodes.astype(np.int64), z, w, offsets)


def _motion(poses: Floats, of_each: Indices, priors: Priors) -> Floats | None:
    """Return the motion of a rigid part onto its priors, or None if they leave it open."""
    nodes, own = np.unique(of_each, return_inverse=True)
    there, count = poses[nodes], len(nodes)
    d = 2 if poses.shape[1] == 3 else 3
    weight = _STIFFNESS * float(np.einsum("kii->k", priors.information).max())
    extent = 1 + float(np.square(np.ptp(there[:, :d], axis=0)).sum())
    dof = priors.information.shape[1]
    stiff = weight * np.diag([1.0] * d + [extent] * (dof - d))
    chain = np.column_stack([np.arange(count - 1), np.arange(1, count)])
    part = PoseGraph.from_arrays(
        chain,
        lie.between(there[:-1], there[1:]),
        np.tile(stiff, (count - 1, 1, 1)),
        ids=np.arange(count),
    ).with_priors(priors.renamed(own.astype(np.int64)))
    placed, _, kept = placed_assembly(assemble(part), odometry)
    if kept:
        return None
    assert placed.graph.poses is not None
    found = placed.graph.poses[placed.poses_at]
    try:
        result = optimize(placed.disassembled(placed.graph.poses))
        spread = np.linalg.eigvalsh(covariances(result.graph, [0])[0][d:, d:])[-1]
    except OptimizationError:
        return None  # They determine it so little that rounding decides.
    # In 3D the covariance is that of half the angle.
    if np.sqrt(spread) * (1 if d == 2 else 2) > _MAX_ANGLE:
        return None
    return lie.compose(found[:1], lie.inverse(there[:1]))


def positions_of_landmarks(rows: AnyArray, seen_from: Floats) -> tuple[Floats, Flags]:
    """Return where landmarks are that no observation places by itself, and which are determined.

    Parameters
    ----------
    rows : structured ndarray, (k,)
        Observations from poses of one part.
    seen_from : ndarray, (k, 3) or (k, 7)
        The pose of each.

    Returns
    -------
    (positions, determined) : ndarray, (l, d), and ndarray of bool, (l,)
        In the order of the ascending ids of the landmarks.
    """
    d = 2 if seen_from.shape[1] == 3 else 3
    ids, own, count = np.unique(rows["node"], return_inverse=True, return_counts=True)
    seen = landmarks_of(rows, ids, np.zeros((len(ids), d)))
    assert seen is not None
    extent = np.sqrt(np.square(np.ptp(seen_from[:, :d], axis=0)).sum())
    found = triangulated(seen, seen_from, usual=float(extent) or 1.0)
    distance = np.sqrt(np.square(seen_from[:, :d] - found.points[own]).sum(axis=1))
    mean = np.bincount(own, distance) / count
    least = np.linalg.eigvalsh(found.information)[:, 0]
    determined = least * np.square(_MAX_SPREAD * mean) > 1
    return found.points, determined & ~found.doubtful


def undetermined_rows(contents: dict[str, Any]) -> Flags:
    """Tell which priors and observations join nodes to others without determining them.

    Without these rows, the parts of the map are determined, each in its own frame.

    Parameters
    ----------
    contents : dict
        Contents of the core's map.

    Returns
    -------
    ndarray of bool, (k,)
        In the order of `rows_of`.
    """
    rows = rows_of(contents)
    open_ = np.zeros(len(rows), np.bool_)
    if _are_placed_by_one_body(contents, rows):
        return open_
    for _ in range(_MAX_ROUNDS):
        graph = graph_of(with_rows(contents, rows[~open_]))
        if graph.priors is None and graph.landmarks is None:
            break
        assembly = assemble(graph)
        found = undetermined(assembly)
        if not found:
            break
        bodies, ids = body_of_each_node(assembly), assembly.graph.ids
        is_free = np.zeros(int(bodies.max()) + 1, np.bool_)
        is_free[bodies[[freedom.node for freedom in found]]] = True
        to = bodies[np.searchsorted(ids, rows["node"])]
        world = bodies[assembly.world]
        by = np.where(rows["is_prior"], world, bodies[np.searchsorted(ids, rows["pose"])])
        # A landmark that one body alone sees goes with it.
        pairs = np.unique(np.stack([to, by], 1)[~open_], axis=0)
        observers = np.bincount(pairs[:, 0], minlength=len(is_free))
        joins = (observers[to] > 1) | rows["is_prior"]
        more = ~open_ & (is_free[to] | (is_free[by] & joins))
        if not more.any():
            break
        open_ |= more
    return open_


def _are_placed_by_one_body(contents: dict[str, Any], rows: AnyArray) -> bool:
    """Whether nothing but edges joins poses, and single observations place all landmarks.

    That costs little to tell, and leaves nothing undetermined.
    """
    if rows["is_prior"].any():
        return False
    ids = np.sort(contents["ids"][~contents["points"]])
    nothing = np.empty(0, np.int64)
    edges = Structure(ids, contents["edges"], nothing, contents["information"].shape[1])
    body = edges.components[edges.index(rows["pose"])]
    observed, own = np.unique(rows["node"], return_inverse=True)
    order = np.argsort(own, kind="stable")
    same = (np.diff(own[order]) != 0) | (np.diff(body[order]) == 0)
    return bool(same.all() and np.isin(np.arange(len(observed)), own[places(rows)]).all())
