"""What `PoseGraph` demands of its arrays."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from masat.arrays import Floats, Ids
from masat.errors import GraphError, InformationError
from masat.information import indefinite

# Printed quaternions are off unit length by their rounding; a norm further off is no rotation.
_QUATERNION_TOLERANCE = 1e-2
_UNIT_TO_ROUNDING = 1e-14


def matrix(name: str, values: ArrayLike) -> Floats:
    """Return a contiguous copy of a table of numbers."""
    try:
        table = np.array(values, np.float64, order="C")
    except (OverflowError, TypeError, ValueError) as error:
        raise GraphError(f"{name} must be numbers: {error}") from None
    if table.size == 0 and table.ndim < 2:
        return table.reshape(0, 3)
    if table.ndim != 2:
        raise GraphError(f"{name} must be a table, one row each, got shape {table.shape}")
    return table


def integers(name: str, values: ArrayLike) -> Ids:
    try:
        whole = np.asarray(values)
    except (OverflowError, ValueError) as error:
        raise GraphError(f"{name} must be integers: {error}") from None
    if whole.size and (whole.dtype.kind not in "iu" or whole.max() > np.iinfo(np.int64).max):
        raise GraphError(f"{name} must be integers of at most 64 bits, got {whole.dtype}")
    return np.array(whole, np.int64, order="C")


def distinct(values: Ids) -> Ids:
    """Return the distinct values, ascending; `np.unique` loads far more than it needs."""
    ordered: Ids = np.sort(values, axis=None)
    first = np.ones(len(ordered), np.bool_)
    first[1:] = ordered[1:] != ordered[:-1]
    return ordered[first]


def ascending(nodes: Ids, poses: Floats | None) -> tuple[Ids, Floats | None]:
    rising = nodes[1:] > nodes[:-1]
    if rising.all():
        return nodes, poses
    order = np.argsort(nodes, kind="stable")
    twice = np.flatnonzero(np.diff(nodes[order]) == 0)
    if len(twice):
        second = order[twice[0] + 1]
        raise GraphError(f"the node id {nodes[second]} occurs twice", node=int(second))
    return nodes[order], None if poses is None else poses[order]


def known_edges(nodes: Ids, pairs: Ids) -> None:
    loops = np.flatnonzero(pairs[:, 0] == pairs[:, 1])
    if len(loops):
        k = int(loops[0])
        raise GraphError(f"edge {k} joins node {pairs[k, 0]} to itself", edge=k)
    if without_gaps(nodes):
        known = (pairs >= nodes[0]) & (pairs <= nodes[-1])
    else:
        known = nodes[np.searchsorted(nodes, pairs).clip(max=len(nodes) - 1)] == pairs
    unknown = np.argwhere(~known)
    if len(unknown):
        k, end = unknown[0]
        raise GraphError(
            f"edge {k} ({pairs[k, 0]} -> {pairs[k, 1]}) names node {pairs[k, end]}, "
            "which is not among the nodes",
            edge=int(k),
        )


def rotations(poses: Floats, what: str, names: Ids, kind: str) -> Floats:
    """Check that poses are finite and normalize their quaternions."""

    def refuse(row: int, why: str) -> None:
        name = names[row] if kind == "node" else f"{row} ({names[row, 0]} -> {names[row, 1]})"
        message = f"the {what} {name} {why}"
        raise GraphError(message, edge=row) if kind == "edge" else GraphError(message, node=row)

    if not np.isfinite(poses).all():
        refuse(int(np.flatnonzero(~np.isfinite(poses).all(axis=1))[0]), "is not finite")
    if poses.shape[1] == 7 and len(poses):
        q = poses[:, 3:]
        squared = np.einsum("ij,ij->i", q, q)
        off = np.abs(squared - 1)
        worst = np.flatnonzero(off > 2 * _QUATERNION_TOLERANCE)
        if len(worst):
            row = int(worst[0])
            refuse(row, f"has a quaternion of length {squared[row] ** 0.5:.6g}, expected 1")
        rounded = off > _UNIT_TO_ROUNDING
        q[rounded] /= np.sqrt(squared[rounded])[:, None]
    return poses


def information_matrices(information: ArrayLike | None, pairs: Ids, dof: int) -> Floats:
    m = len(pairs)
    if information is None:
        return np.ascontiguousarray(np.broadcast_to(np.eye(dof), (m, dof, dof)))
    try:
        given = np.asarray(information, np.float64)
    except (OverflowError, TypeError, ValueError) as error:
        raise GraphError(f"information must be numbers: {error}") from None
    if given.shape not in ((dof, dof), (m, dof, dof)):
        raise GraphError(
            f"information must have shape ({m}, {dof}, {dof}) or ({dof}, {dof}), got {given.shape}"
        )
    matrices = np.array(np.broadcast_to(given, (m, dof, dof)), order="C")
    flat = matrices.reshape(m, dof * dof)
    if not np.isfinite(flat).all():
        k = int(np.flatnonzero(~np.isfinite(flat).all(axis=1))[0])
        raise GraphError(f"the information of {_edge(pairs, k)} is not finite", edge=k)
    flipped = matrices.transpose(0, 2, 1)
    if not np.array_equal(matrices, flipped):
        scale = np.abs(flat).max(axis=1)
        with np.errstate(over="ignore"):
            skew = np.abs(matrices - flipped).reshape(flat.shape).max(axis=1)
        skewed = skew > 1e-9 * scale
        if skewed.any():
            k = int(np.flatnonzero(skewed)[0])
            raise InformationError(
                f"the information of {np.count_nonzero(skewed)} of {m} edges is not symmetric, "
                f"first of {_edge(pairs, k)}",
                edge=k,
                count=int(np.count_nonzero(skewed)),
            )
        matrices = 0.5 * matrices + 0.5 * flipped
    bad = indefinite(matrices)
    if len(bad):
        k = int(bad[0])
        raise InformationError(
            f"the information matrices of {len(bad)} of {m} edges are not positive definite, "
            f"first that of {_edge(pairs, k)}, smallest eigenvalue "
            f"{np.linalg.eigvalsh(matrices[k])[0]:.6g}",
            edge=k,
            count=len(bad),
        )
    return matrices


def without_gaps(nodes: Ids) -> bool:
    """Tell whether ascending ids are consecutive."""
    return int(nodes[-1]) - int(nodes[0]) == len(nodes) - 1


def _edge(pairs: Ids, k: int) -> str:
    return f"edge {k} ({pairs[k, 0]} -> {pairs[k, 1]})"
