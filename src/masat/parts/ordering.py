"""The order in which the nodes of a part are eliminated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from masat import _core
from masat.arrays import Indices
from masat.parts.elimination import PieceNodes
from masat.parts.pieces import Piece
from masat.structure import nested_dissection

# A larger boundary is not joined to a clique, whose edges grow with its square.
_MAX_CLIQUE = 1000


def ordered(piece: Piece, dof: int) -> tuple[Piece, PieceNodes]:
    """Return a part with the elimination order of the fewest operations, and its nodes.

    The candidates are minimum degree, with the boundary as nodes that are all joined to each other,
    which is what an elimination makes of them, and the nested dissection of the own nodes.
    """
    nodes = PieceNodes(piece)
    outside = np.ones(len(piece.ids), np.bool_)
    outside[: piece.own] = False
    nothing = np.empty(0, np.int32)
    inside = _core.Elimination(nodes.topology, outside, nothing)
    orders = [_around_clique(piece), nested_dissection(inside)]
    candidates = [_with_order(piece, order) for order in orders if order is not None]
    if not candidates:
        candidates = [_with_order(piece, inside.order())]
    return min(candidates, key=lambda found: found[1].elimination.operations(dof))


def _around_clique(piece: Piece) -> Indices | None:
    """Return the order of minimum degree in front of the boundary, None if that is too large."""
    if piece.boundary > _MAX_CLIQUE:
        return None
    free = piece.own + piece.boundary
    first, second = np.triu_indices(piece.boundary, 1)
    clique = piece.own + np.stack([first, second], 1)
    edges = np.concatenate([piece.edges, clique]).astype(np.int32)
    topology = _core.Topology(len(piece.ids), np.ascontiguousarray(edges))
    fixed = np.arange(len(piece.ids)) >= free
    order = _core.Elimination(topology, fixed, np.empty(0, np.int32)).order()
    own: Indices = order[order < piece.own]
    return own


def _with_order(piece: Piece, order: Indices) -> tuple[Piece, PieceNodes]:
    changed = replace(piece, order=order)
    return changed, PieceNodes(changed)
