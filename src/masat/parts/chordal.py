"""The two linear systems of the chordal guess, of a piece.

Its rotations, and then its positions, are those of `masat.initializers.chordal`, to rounding.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from masat import _core, lie
from masat.arrays import Floats
from masat.information import rotation_weights
from masat.initializers.chordal import columns_of, square
from masat.linear import rotation_blocks
from masat.parts.elimination import Eliminated, Message, PieceNodes


class Linear(NamedTuple):
    """One of the two systems: that of the rotations or, at poses of these, of the positions."""

    poses: str | None

    @property
    def unknown(self) -> str:
        """What it solves for."""
        return "pose" if self.poses is None else "position"


class LinearSystem:
    """A linear system of a piece, without its own nodes.

    Parameters
    ----------
    nodes : PieceNodes
        The nodes of the piece.
    poses : ndarray or None
        Poses of its own nodes and of its boundary, whose positions are wanted; None if rotations
        are.
    messages : sequence of Message
        Those of the children.
    """

    def __init__(
        self, nodes: PieceNodes, poses: Floats | None, messages: Sequence[Message]
    ) -> None:
        piece, d = nodes.piece, nodes.piece.dimension
        self._poses, self._nodes = poses, nodes
        matrix = _core.GraphMatrix(nodes.elimination, d)
        if poses is None:
            at = nodes.poses(np.tile(lie.identity(d), (nodes.free, 1)))
            blocks = rotation_blocks(piece.measurements, rotation_weights(piece.information))
            columns = columns_of(at, np.flatnonzero(nodes.fixed))
            rhs = matrix.assemble(nodes.topology, *blocks, columns)
        else:
            rhs = matrix.assemble_translations(
                nodes.topology, piece.measurements, piece.information, nodes.poses(poses)
            )
        rows = rhs.reshape(-1, rhs.shape[2])
        self._eliminated = Eliminated(piece, matrix, d, rows, np.zeros(len(rows)), messages)

    @property
    def message(self) -> Message:
        """What is left at the boundary."""
        return self._eliminated.message

    def solve(self, above: Floats | None) -> tuple[Floats, Floats]:
        """Return the unknowns at the own nodes and at the boundary, and the poses that they make.

        Parameters
        ----------
        above : ndarray, optional
            The unknowns of the parent; None without one.
        """
        d = self._nodes.piece.dimension
        unknowns = self._eliminated.solve(above)
        if self._poses is None:
            turned = square(unknowns.reshape(-1, d, unknowns.shape[1]))
            return unknowns, _core.nearest_rotations(
                np.ascontiguousarray(turned.transpose(0, 2, 1))
            )
        steps = np.zeros((len(self._poses), lie.DOF[d]))
        steps[:, :d] = unknowns.reshape(-1, d)
        return unknowns, lie.retract(self._poses, steps)
