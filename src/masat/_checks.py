"""The checks that `PoseGraph` makes on its arrays; each failure is one `GraphError`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from masat.arrays import AnyArray, Flags, Floats, Ids, Labels
from masat.errors import GraphError, InformationError
from masat.information import not_semidefinite

# Quaternions in files are off unit length by the rounding of their decimals, which is far less.
_MAX_LENGTH_ERROR = 1e-2
_UNIT_TO_ROUNDING = 1e-14
# NumPy pads each string to the longest, with 4 bytes a character: this bounds the memory.
_MAX_LABEL_LENGTH = 64
_NAMES_OF_KINDS = {
    "b": "booleans",
    "c": "complex numbers",
    "m": "durations",
    "M": "dates",
    "S": "bytes",
    "T": "strings",
    "U": "strings",
    "V": "records",
}

_Scalar = TypeVar("_Scalar", bound=np.generic)


def numbers(name: str, values: ArrayLike) -> Floats:
    """Return real numbers as an array, which may share the memory of `values`."""
    raw = _array(name, values, "numbers")
    if raw.size and raw.dtype.kind not in "iuf":
        raise GraphError(f"{name} must be numbers, got {_contents(raw)}")
    return np.asarray(raw, np.float64)


def table(name: str, values: ArrayLike) -> Floats:
    """Return a contiguous copy of a table of numbers; an empty list is a table of shape (0, 0)."""
    out = _copy(numbers(name, values), values)
    if out.size == 0 and out.ndim < 2:
        return out.reshape(0, 0)
    if out.ndim != 2:
        raise GraphError(f"{name} must be a table, one row each, got shape {out.shape}")
    return out


def integers(name: str, values: ArrayLike) -> Ids:
    """Return a contiguous copy of integers."""
    raw = _array(name, values, "integers")
    if raw.size and raw.dtype.kind not in "iu":
        raise GraphError(f"{name} must be integers of at most 64 bits, got {_contents(raw)}")
    if raw.size and raw.dtype.kind == "u" and raw.max() > np.iinfo(np.int64).max:
        raise GraphError(f"{name} must be integers of at most 64 bits and a sign, got {raw.max()}")
    return _copy(np.asarray(raw, np.int64), values)


def row_of_integers(name: str, values: Any) -> Ids:
    """Return distinct integers, ascending, from one integer or any iterable of them."""
    if not isinstance(values, np.ndarray):
        try:
            values = list(values)
        except TypeError:
            values = [values]
    out = integers(name, values)
    if out.ndim > 1:
        raise GraphError(f"{name} must be integers in one row, got shape {out.shape}")
    return distinct(out)


def node_ids(ids: ArrayLike) -> Ids:
    """Return a copy of node ids, (n,)."""
    nodes = integers("ids", ids)
    if nodes.ndim != 1:
        raise GraphError(f"ids must have shape (n,), got {nodes.shape}")
    return nodes


def flags(values: Any) -> Flags | None:
    """Return booleans as an array, or None if the values are no booleans or there are none."""
    raw = _array("a mask", values, "booleans")
    return raw if raw.size and raw.dtype == np.bool_ else None


def pairs_of_ids(edges: ArrayLike) -> Ids:
    """Return a copy of the edges, (m, 2)."""
    pairs = integers("edges", edges)
    if pairs.size == 0 and pairs.ndim < 2:
        pairs = pairs.reshape(0, 2)
    if pairs.ndim != 2 or pairs.shape[1] != 2:
        raise GraphError(f"edges must have shape (m, 2), got {pairs.shape}")
    return pairs


def distinct(values: Ids) -> Ids:
    """Return the distinct values, ascending; `np.unique` loads far more than it needs."""
    ordered: Ids = np.sort(values, axis=None)
    first = np.ones(len(ordered), np.bool_)
    first[1:] = ordered[1:] != ordered[:-1]
    return ordered[first]


def ascending(nodes: Ids, poses: Floats | None) -> tuple[Ids, Floats | None]:
    """Return the nodes in ascending order, and their poses in the same."""
    if (nodes[1:] > nodes[:-1]).all():
        return nodes, poses
    order = np.argsort(nodes, kind="stable")
    twice = np.flatnonzero(np.diff(nodes[order]) == 0)
    if len(twice):
        second = order[twice[0] + 1]
        raise GraphError(f"the node id {nodes[second]} occurs twice", node=int(second))
    return nodes[order], None if poses is None else poses[order]


def known_nodes(nodes: Ids, wanted: Ids, what: str) -> None:
    """Refuse ids that are not among the ascending `nodes`."""
    for node in wanted[~among(nodes, wanted)][:1]:
        raise GraphError(f"the {what} {node} is not in the graph")


def known_edges(nodes: Ids, pairs: Ids) -> None:
    """Refuse edges from a node to itself, and edges that name a node not among `nodes`."""
    no_loops(pairs)
    for k, end in np.argwhere(~among(nodes, pairs))[:1]:
        raise GraphError(
            f"{edge_name(pairs, k)} names node {pairs[k, end]}, which is not among the nodes",
            edge=int(k),
        )


def no_loops(pairs: Ids) -> None:
    for k in np.flatnonzero(pairs[:, 0] == pairs[:, 1])[:1]:
        raise GraphError(f"edge {k} joins node {pairs[k, 0]} to itself", edge=int(k))


def rotations(poses: Floats, what: str, names: Ids, kind: str) -> Floats:
    """Return the poses, normalized in place; refuse what is not finite or far from unit length."""

    def refuse(row: int, why: str) -> None:
        if kind == "edge":
            raise GraphError(f"the {what} of {edge_name(names, row)} {why}", edge=row)
        raise GraphError(f"the {what} of {kind} {names[row]} {why}", node=row)

    if not np.isfinite(poses).all():
        refuse(int(np.flatnonzero(~np.isfinite(poses).all(axis=1))[0]), "is not finite")
    if poses.shape[1] == 7 and len(poses):
        q = poses[:, 3:]
        squared = np.einsum("ij,ij->i", q, q)
        off = np.abs(squared - 1)
        for row in np.flatnonzero(off > 2 * _MAX_LENGTH_ERROR)[:1]:
            refuse(int(row), f"has a quaternion of length {squared[row] ** 0.5:.6g}, expected 1")
        rounded = off > _UNIT_TO_ROUNDING
        q[rounded] /= np.sqrt(squared[rounded])[:, None]
    return poses


def information_matrices(information: ArrayLike | None, pairs: Ids, dof: int) -> Floats:
    """Return a copy of the edges' information, (m, dof, dof), checked and exactly symmetric."""
    return semidefinite_matrices(information, len(pairs), dof, lambda k: edge_name(pairs, k))


def semidefinite_matrices(
    information: ArrayLike | None,
    m: int,
    dof: int,
    name: Callable[[int], str],
    plural: str = "edges",
) -> Floats:
    """Return a copy of matrices, (m, dof, dof), checked, not zero and exactly symmetric."""
    if information is None:
        return np.ascontiguousarray(np.broadcast_to(np.eye(dof), (m, dof, dof)))
    given = numbers("information", information)
    if given.shape not in ((dof, dof), (m, dof, dof)):
        raise GraphError(
            f"information must have shape ({m}, {dof}, {dof}) or ({dof}, {dof}), got {given.shape}"
        )
    matrices = np.array(np.broadcast_to(given, (m, dof, dof)), order="C")
    flat = matrices.reshape(m, dof * dof)
    if not np.isfinite(flat).all():
        k = int(np.flatnonzero(~np.isfinite(flat).all(axis=1))[0])
        raise GraphError(f"the information of {name(k)} is not finite", edge=k)
    flipped = matrices.transpose(0, 2, 1)
    if not np.array_equal(matrices, flipped):
        scale = np.abs(flat).max(axis=1)
        with np.errstate(over="ignore"):
            skew = np.abs(matrices - flipped).reshape(flat.shape).max(axis=1)
        skewed = skew > 1e-9 * scale
        if skewed.any():
            k = int(np.flatnonzero(skewed)[0])
            raise InformationError(
                f"the information of {np.count_nonzero(skewed)} of {m} {plural} is not symmetric, "
                f"first of {name(k)}",
                edge=k,
                count=int(np.count_nonzero(skewed)),
            )
        matrices = 0.5 * matrices + 0.5 * flipped
    bad = not_semidefinite(matrices)
    if len(bad):
        k = int(bad[0])
        raise InformationError(
            f"the information matrices of {len(bad)} of {m} {plural} are zero or not "
            f"positive semidefinite, first that of {name(k)}, smallest eigenvalue "
            f"{np.linalg.eigvalsh(matrices[k])[0]:.6g}",
            edge=k,
            count=len(bad),
        )
    return matrices


def finite(values: Floats, what: str, names: Ids) -> Floats:
    """Return the rows; refuse numbers that are not finite."""
    for row in np.flatnonzero(~np.isfinite(values).all(axis=1))[:1]:
        raise GraphError(f"the {what} {names[row]} is not finite", node=int(row))
    return values


def edge_labels(labels: Any, count: int) -> Labels | None:
    """Return a copy of the labels, one an edge: int64, or strings of at most 64 characters."""
    if labels is None:
        return None
    raw = _array("labels", labels, "integers or strings")
    if raw.dtype.kind == "T":
        raw = raw.astype(np.str_)
    if raw.shape not in ((), (count,)):
        raise GraphError(f"labels must have shape ({count},) or be one label, got {raw.shape}")
    mixed = raw.dtype.kind == "U" and isinstance(labels, list | tuple)
    if mixed and not all(isinstance(label, str) for label in labels):
        raise GraphError("labels must be all integers or all strings")
    if raw.size == 0:
        return np.zeros(0, raw.dtype if raw.dtype.kind == "U" else np.int64)
    if raw.dtype.kind != "U":
        if raw.dtype.kind not in "iu":
            raise GraphError(f"labels must be integers or strings, got {_contents(raw)}")
        return np.array(np.broadcast_to(integers("labels", raw), count))
    row = np.ravel(raw)
    length = np.char.str_len(row)
    for k in np.flatnonzero(length > _MAX_LABEL_LENGTH)[:1]:
        raise GraphError(
            f"the label of edge {k} has {length[k]} characters: at most {_MAX_LABEL_LENGTH} fit",
            edge=int(k),
        )
    row = np.ascontiguousarray(row, f"=U{max(int(length.max()), 1)}")
    for k in np.flatnonzero(_unprintable(row))[:1]:
        raise GraphError(
            f"the label of edge {k}, {str(row[k])!r}, holds a control character or a line break",
            edge=int(k),
        )
    return np.array(np.broadcast_to(row, count)) if raw.ndim == 0 else row.copy()


def among(nodes: Ids, wanted: Ids) -> Flags:
    """Tell which of the wanted ids are among the ascending `nodes`."""
    if without_gaps(nodes):
        known: Flags = (wanted >= nodes[0]) & (wanted <= nodes[-1])
    else:
        known = nodes[np.searchsorted(nodes, wanted).clip(max=len(nodes) - 1)] == wanted
    return known


def without_gaps(nodes: Ids) -> bool:
    """Tell whether ascending ids are consecutive."""
    return int(nodes[-1]) - int(nodes[0]) == len(nodes) - 1


def edge_name(pairs: Ids, k: int) -> str:
    """Return how messages name an edge: its index and its nodes."""
    return f"edge {k} ({pairs[k, 0]} -> {pairs[k, 1]})"


def _array(name: str, values: Any, expected: str) -> AnyArray:
    """Return the values as an array of whatever type, without copying one."""
    try:
        raw = np.asarray(values)
    except (OverflowError, TypeError, ValueError) as error:
        row = _first_uneven(values)
        why = str(error) if row is None else f"row {row} is not as long as row 0"
        raise GraphError(f"{name} must be {expected}: {why}") from None
    # The rows of a list may be masked as well.
    several = values if isinstance(values, list | tuple) else [values]
    if any(isinstance(a, np.ndarray) and type(a) is not np.ndarray for a in several):
        mask = np.ma.getmaskarray(np.ma.asarray(values))
        for row in np.argwhere(mask)[:1]:
            where = f"row {row[0]} of {name}" if len(row) else name
            raise GraphError(f"{where} is masked: fill it in or leave it out")
    return raw


def _first_uneven(rows: Any) -> int | None:
    """Return the first row whose length differs from that of row 0."""
    try:
        lengths = [np.size(row) for row in rows]
    except (TypeError, ValueError):
        return None
    return next((k for k, length in enumerate(lengths) if length != lengths[0]), None)


def _contents(raw: AnyArray) -> str:
    """Say what an array holds that should hold numbers."""
    if raw.dtype.kind == "O":
        return f"an object such as {raw.flat[0]!r:.40}"
    return _NAMES_OF_KINDS.get(raw.dtype.kind, str(raw.dtype))


def _copy(converted: NDArray[_Scalar], values: Any) -> NDArray[_Scalar]:
    """Return a contiguous array that shares no memory with what the caller gave."""
    # What is made of a list is new already.
    if isinstance(values, list | tuple):
        return np.asarray(converted, order="C")
    return np.array(converted, order="C")


def _unprintable(row: AnyArray) -> AnyArray:
    """Tell which strings hold control characters, line breaks or what UTF-8 cannot hold."""
    codes = row.view(np.uint32).reshape(len(row), row.dtype.itemsize // 4)
    bad: AnyArray = (codes < 32) & (codes > 0) | (codes >= 127) & (codes < 160)
    bad = bad | (codes == 0x2028) | (codes == 0x2029) | (codes >= 0xD800) & (codes <= 0xDFFF)
    # Zeros pad a string; before another character they belong to it.
    bad[:, :-1] |= (codes[:, :-1] == 0) & (codes[:, 1:] != 0)
    return np.asarray(bad.any(axis=1))
