"""The linear systems of a piece: set up, eliminated up to its boundary, solved from there."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np

from masat import _core, lie
from masat.arrays import Flags, Floats, Indices
from masat.optimizers.damped import LINEAR, damping_scale
from masat.optimizers.losses import LOSSES, NamedLoss
from masat.optimizers.termination import largest
from masat.parts.pieces import Piece


class Linearization(NamedTuple):
    """What the other pieces have to know of the system of a piece.

    Attributes
    ----------
    cost : float
        chi2 of its edges, or their robust cost.
    scale, steepest : float
        Largest entry of the diagonal by which steps are damped, and of the gradient's negative
        half, over the nodes that no other piece adds to; 0 in a separator.
    diagonal, rhs : ndarray
        What its edges add to the diagonal of H and to the gradient's negative half of the nodes
        in `Piece.separators`.
    """

    cost: float
    scale: float
    steepest: float
    diagonal: Floats
    rhs: Floats


class Message(NamedTuple):
    """What an elimination leaves at the boundary.

    Attributes
    ----------
    block : ndarray
        The Schur complement, lower triangle, packed column by column.
    rhs : ndarray, (b, k)
        The reduced right-hand sides.
    failed : int or None
        The id of a node at which the matrix is not positive definite; then nothing else is known.
    """

    block: Floats
    rhs: Floats
    failed: int | None = None


class Step(NamedTuple):
    """The step of a piece.

    Attributes
    ----------
    values : ndarray
        At its own nodes and at its boundary.
    squared : float
        The squared length at its own nodes.
    predicted : float
        What its edges and its damping add to the fall of chi2 that is predicted.
    """

    values: Floats
    squared: float
    predicted: float


class Solution(NamedTuple):
    """What a step of all pieces leads to in one of them.

    Attributes
    ----------
    step : Step
        Its step.
    after : Linearization
        That at the poses after the step.
    failed : int or None
        The id of a node at which a matrix is not positive definite; then nothing else is known.
    """

    step: Step
    after: Linearization
    failed: int | None = None


class PieceNodes:
    """The nodes of the systems of a piece, and how they are eliminated.

    They are its own, its boundary, one for the contribution block of each child, and the fixed
    ones.

    Parameters
    ----------
    piece : Piece
        The piece.
    """

    def __init__(self, piece: Piece) -> None:
        self.piece = piece
        self.free = piece.own + piece.boundary
        self.count = len(piece.ids) + piece.children

    @cached_property
    def topology(self) -> _core.Topology:
        """The adjacency by the edges."""
        return _core.Topology(self.count, self._edges)

    @cached_property
    def elimination(self) -> _core.Elimination:
        """How the own nodes are eliminated, around the blocks of the children."""
        piece = self.piece
        elements = self.free + np.arange(piece.children, dtype=np.int32)
        joined = np.repeat(elements, np.diff(piece.child_start))
        edges = np.concatenate([self._edges, np.stack([joined, piece.child_nodes], 1)])
        order = np.concatenate(
            [elements, piece.order, np.arange(piece.own, self.free, dtype=np.int32)]
        )
        topology = _core.Topology(self.count, np.ascontiguousarray(edges))
        return _core.Elimination(topology, self.fixed, order, piece.boundary, piece.children)

    @cached_property
    def fixed(self) -> Flags:
        """Which nodes are fixed."""
        return np.arange(self.count) >= self.free + self.piece.children

    def poses(self, free: Floats) -> Floats:
        """Return poses of all nodes; those that stand for blocks of children have no edges."""
        unused = np.tile(lie.identity(self.piece.dimension), (self.piece.children, 1))
        return np.concatenate([free, unused, self.piece.fixed_poses])

    @cached_property
    def _edges(self) -> Indices:
        fixed = self.piece.edges >= self.free
        edges: Indices = np.where(fixed, self.piece.edges + self.piece.children, self.piece.edges)
        return np.ascontiguousarray(edges.astype(np.int32))


class Eliminated:
    """A linear system of a piece without its own nodes, and what is left at the boundary.

    Parameters
    ----------
    piece : Piece
        The piece.
    matrix : NormalEquations or GraphMatrix
        Its matrix H.
    size : int
        Rows of a node.
    rhs : ndarray, (r, k)
        The right-hand sides of all rows of the matrix. Overwritten.
    damping : ndarray, (r,)
        What is added to the diagonal.
    messages : sequence of Message
        Those of the children.
    """

    def __init__(
        self,
        piece: Piece,
        matrix: _core.NormalEquations | _core.GraphMatrix,
        size: int,
        rhs: Floats,
        damping: Floats,
        messages: Sequence[Message],
    ) -> None:
        nothing = np.empty(0)
        for message in messages:
            if message.failed is not None:
                self.message = message
                return
        self._piece, self._matrix, self._size = piece, matrix, size
        self._own, self._all = piece.own * size, (piece.own + piece.boundary) * size
        for k, message in enumerate(messages):
            shape = -1, size, rhs.shape[1]
            rhs.reshape(shape)[piece.child(k)] += message.rhs.reshape(shape)
        blocks = [(piece.child(k), message.block) for k, message in enumerate(messages)]
        failed = matrix.factorize(damping, blocks)
        if failed >= 0:
            self.message = Message(nothing, nothing, int(piece.ids[failed]))
            return
        self._reduced = _by_columns(matrix.reduce, rhs)
        self.message = Message(matrix.contribution(), self._reduced[self._own : self._all].copy())

    def solve(self, above: Floats | None) -> Floats:
        """Return the solution at the own nodes and at the boundary, (r, k).

        Parameters
        ----------
        above : ndarray, optional
            That of the parent; None without one.
        """
        x = self._reduced
        if above is not None:
            x = x.copy()
            values = above.reshape(-1, self._size, x.shape[1])[self._piece.in_parent]
            x[self._own : self._all] = values.reshape(-1, x.shape[1])
        return _by_columns(self._matrix.substitute, x)[: self._all]


def _by_columns(change: Callable[[Floats], Floats], rows: Floats) -> Floats:
    """Return a table whose columns are changed one by one."""
    out = np.empty_like(rows)
    for k in range(rows.shape[1]):
        out[:, k] = change(np.ascontiguousarray(rows[:, k]))
    return out


class PieceSystem:
    """The normal equations of a piece.

    Parameters
    ----------
    nodes : PieceNodes
        The nodes of the piece.
    loss : tuple of str and float, optional
        Name and scale of the loss that is minimized. Default: chi2 is.
    trusted : ndarray of bool, (m,), optional
        The edges to which the loss does not apply. Default: none.
    threads : int
        Threads that compute.
    """

    def __init__(
        self,
        nodes: PieceNodes,
        loss: NamedLoss | None = None,
        trusted: Flags | None = None,
        threads: int = 1,
    ) -> None:
        self.piece, self._nodes = nodes.piece, nodes
        self._loss = None if loss is None else _core.Loss(LOSSES[loss[0]].kind, loss[1])
        self._trusted, self._threads = trusted, threads
        self._dof = lie.DOF[nodes.piece.dimension]
        self._step_size = nodes.free * self._dof

    def chi2(self, poses: Floats) -> float:
        """Return the chi2 of the edges, at poses of the own nodes and of the boundary."""
        return self._equations.chi2(self._nodes.poses(poses))

    def linearize(self, poses: Floats) -> Linearization:
        """Set the system at poses of the own nodes and of the boundary."""
        piece, d = self.piece, self.piece.dimension
        at = self._nodes.poses(poses)
        if self._loss is None:
            cost = self._equations.linearize(at)
        else:
            cost = self._equations.linearize_robust(at, self._loss, self._trusted)
        diagonal = self._equations.diagonal()[: self._step_size]
        rhs = self._equations.rhs()[: self._step_size]
        if piece.children:
            return Linearization(cost, 0.0, 0.0, diagonal, rhs)
        end = piece.own * self._dof
        scale = diagonal[:end].reshape(-1, self._dof).max(axis=0, initial=0.0)
        scale[:d] *= LINEAR
        steepest = largest(rhs[:end]) if end else 0.0
        return Linearization(cost, float(scale.max()), steepest, diagonal[end:], rhs[end:])

    def eliminate(
        self,
        damping: float,
        floor: float,
        diagonal: Floats | None,
        messages: Sequence[Message],
    ) -> Message:
        """Eliminate the own nodes from the linearized system.

        Parameters
        ----------
        damping : float
            Factor of the diagonal that is added.
        floor : float
            Smallest entry of that diagonal.
        diagonal : ndarray, optional
            The diagonal of H at the own nodes. Default: that of the edges of the piece alone.
        messages : sequence of Message
            Those of the children.
        """
        piece, end = self.piece, self.piece.own * self._dof
        rhs = self._equations.rhs()
        self._damping = np.zeros_like(rhs)
        if damping > 0 and end > 0:
            if diagonal is None:
                diagonal = self._equations.diagonal()[:end]
            self._damping[:end] = damping * damping_scale(diagonal, piece.dimension, floor)
        self._eliminated = Eliminated(
            piece, self._equations, self._dof, rhs[:, None], self._damping, messages
        )
        return self._eliminated.message

    def substitute(self, above: Floats | None) -> Step:
        """Return the step after an elimination.

        Parameters
        ----------
        above : ndarray, optional
            The step of the parent; None without one.
        """
        end = self.piece.own * self._dof
        step = self._eliminated.solve(above)[:, 0]
        own = step[:end]
        gradient = float((step * self._equations.rhs()[: self._step_size]).sum())
        damped = float((self._damping[:end] * np.square(own)).sum())
        return Step(step, float(np.square(own).sum()), gradient + damped)

    @cached_property
    def _equations(self) -> _core.NormalEquations:
        piece = self.piece
        return _core.NormalEquations(
            self._nodes.topology,
            self._nodes.elimination,
            piece.measurements,
            piece.information,
            self._threads,
            offsets=piece.offsets,
            range_bearing=piece.range_bearing,
        )
