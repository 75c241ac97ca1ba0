"""What the pieces of a partition hold, put together again."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np

from masat.arrays import Flags, Floats, Ids
from masat.graph import PoseGraph
from masat.measurements.landmarks import Landmarks
from masat.measurements.priors import Priors
from masat.parts.index import Index
from masat.parts.pieces import Piece
from masat.residuals import measurements_of


class Nodes(NamedTuple):
    """Nodes of a graph, ascending by id.

    Attributes
    ----------
    ids : ndarray of int64, (n,)
        Their ids.
    poses : ndarray, (n, 3) or (n, 7)
        Their poses; those of landmarks have no rotation.
    is_point : ndarray of bool, (n,)
        Which are landmarks.
    """

    ids: Ids
    poses: Floats
    is_point: Flags


def nodes_of(index: Index, pieces: Iterable[tuple[Piece, Floats]]) -> Nodes:
    """Return the nodes of pieces at poses of their own nodes and of their boundary."""
    return _once([_own(index, piece, poses) for piece, poses in pieces])


def graph_of(index: Index, pieces: Iterable[tuple[Piece, Floats]]) -> PoseGraph:
    """Return the graph that was cut, at these poses."""
    nodes, rows, edges, measurements, information, gauge = [], [], [], [], [], []
    offsets, range_bearing = [], []
    for piece, poses in pieces:
        nodes.append(_own(index, piece, poses))
        rows.append(piece.rows)
        edges.append(piece.ids[piece.edges])
        measurements.append(piece.measurements)
        information.append(piece.information)
        gauge.append(piece.ids[piece.own + piece.boundary :])
        offsets.append(piece.offsets)
        range_bearing.append(piece.range_bearing)
    order = np.argsort(np.concatenate(rows))
    pairs, z = np.concatenate(edges)[order], np.concatenate(measurements)[order]
    w = np.concatenate(information)[order]
    ids, poses, is_point = _once(nodes)
    fixed = np.unique(np.concatenate(gauge))
    relative, absolute, seen = slice(index.edges), *_other_rows(index)[:2]
    priors = landmarks = None
    if index.priors:
        arms = _joined(offsets, order, absolute)
        priors = Priors(pairs[absolute, 1], z[absolute], w[absolute], arms)
    if index.landmarks:
        d, flags = index.dimension, _joined(range_bearing, order, seen)
        landmarks = Landmarks(
            ids[is_point],
            poses[is_point, :d],
            pairs[seen],
            measurements_of(z[seen], flags),
            w[seen, :d, :d],
            flags,
        )
    return PoseGraph.from_arrays(
        pairs[relative],
        z[relative],
        w[relative],
        ids=ids[~is_point],
        poses=poses[~is_point],
        fixed=fixed[fixed != index.world] if index.world is not None else fixed,
        priors=priors,
        landmarks=landmarks,
    )


def _joined(arrays: list[Any | None], order: Ids, rows: slice) -> Any | None:
    """Return some rows of what either all pieces have or none."""
    given = [array for array in arrays if array is not None]
    return np.concatenate(given)[order][rows] if len(given) == len(arrays) else None


def _other_rows(index: Index) -> tuple[slice, slice, slice]:
    """Return the rows of priors, of observations, and of what keeps the rotations of landmarks."""
    ends = np.cumsum([index.edges, index.priors, index.observations, index.landmarks]).tolist()
    return slice(*ends[:2]), slice(*ends[1:3]), slice(*ends[2:])


def _own(index: Index, piece: Piece, poses: Floats) -> Nodes:
    """Return the own and the fixed nodes of a piece, but not the world."""
    fixed = piece.ids[piece.own + piece.boundary :]
    ids = np.concatenate([piece.ids[: piece.own], fixed])
    upright = _other_rows(index)[2]
    keeps = (upright.start <= piece.rows) & (piece.rows < upright.stop)
    points = piece.ids[piece.edges[keeps, 1]]
    kept = ids != index.world if index.world is not None else np.ones(len(ids), np.bool_)
    at = np.concatenate([poses[: piece.own], piece.fixed_poses])
    return Nodes(ids[kept], at[kept], np.isin(ids[kept], points))


def _once(nodes: list[Nodes]) -> Nodes:
    """Return each node once: a fixed one is in several pieces."""
    ids = np.concatenate([own.ids for own in nodes])
    every, first = np.unique(ids, return_index=True)
    poses = np.concatenate([own.poses for own in nodes])[first]
    return Nodes(every, poses, np.concatenate([own.is_point for own in nodes])[first])
