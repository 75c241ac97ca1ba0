"""Partitions of graphs: maps that are solved part by part."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike

from masat.arrays import Flags, Floats, Ids
from masat.errors import PartitionError
from masat.graph import PoseGraph
from masat.optimizers.termination import Report
from masat.parts.checkpoints import GIVEN, Checkpoint, read_checkpoint, read_poses
from masat.parts.cost import Cost, table
from masat.parts.cutting import write_partition
from masat.parts.index import Index, read_index
from masat.parts.pieces import Piece, read_piece
from masat.parts.solving import PartitionResult, solve_partition
from masat.parts.whole import graph_of, nodes_of


class Partition:
    """A graph that is cut into parts, in a folder. `masat.partition` makes one.

    Parameters
    ----------
    folder : path-like
        The folder.

    Attributes
    ----------
    folder : Path
        The folder.
    index : Index
        The parts and separators, their tree, and what each of them costs.

    Raises
    ------
    PartitionError
        If the folder holds no partition, or a file of it is missing or damaged.
    """

    def __init__(self, folder: str | os.PathLike[str]) -> None:
        self.folder = Path(folder)
        self.index: Index = read_index(self.folder)

    def __repr__(self) -> str:
        index = self.index
        return f"Partition({str(self.folder)!r}: {index.nodes} nodes in {index.parts} parts)"

    def solve(
        self,
        optimizer: str = "lm",
        *,
        init: str | None = None,
        loss: str | None = None,
        scale: float | None = None,
        trusted: Flags | None = None,
        restart: bool = False,
        client: Any | None = None,
        memory: int | None = None,
        threads: int = 1,
        max_iterations: int = 100,
        relative_tolerance: float = 1e-9,
        report: Report | None = None,
    ) -> PartitionResult:
        """Minimize chi2, or go on where an earlier solve was interrupted.

        The steps are those of `masat.optimize`, to rounding: the same factorization, cut where the
        parts meet. Poses are written to the folder after each iteration. Rotation residuals of half
        a turn, which `masat.optimize` leaves by a nudge, are not looked for.

        Parameters
        ----------
        optimizer : str
            "lm" ("levenberg_marquardt") or "gn" ("gauss_newton").
        init : str, optional
            The initial guess: "given", "chordal", "masat" or "spanning_tree". Default: the poses
            of the graph if it had any, else "chordal". An interrupted solve goes on from its own
            poses.
        loss : str, optional
            A loss of `masat.optimize` by name, except "gnc_tls": the robust cost is minimized. An
            earlier solve with another one is not gone on with: the new one begins at its poses.
            Default: chi2 is minimized.
        scale : float, optional
            The scale of the loss, as of `masat.optimize`.
        trusted : ndarray of bool, (m,), optional
            The edges to which the loss does not apply, such as odometry, in the order of the graph
            that was cut. Default: it applies to all.
        restart : bool
            Whether to forget what an earlier solve has found.
        client : distributed.Client, optional
            Client of a Dask cluster, whose workers must see the folder under the same path.
            Default: this process solves the parts one after the other.
        memory : int, optional
            Without a client, how many bytes the factors may take together. Default: a quarter of
            the machine's memory. With less than all of them take, parts are factorized again when
            they are needed.
        threads : int
            Threads that compute, on a cluster those of each task. The numbers do not depend on it.
            Each part that is held needs memory for each of them.
        max_iterations : int
            Limit of the iterations from now on.
        relative_tolerance : float
            As of `masat.optimize`.
        report : callable, optional
            Called with the `Iteration` after each; returning True stops.

        Returns
        -------
        PartitionResult

        Raises
        ------
        PartitionError
            If a file is missing, damaged or of another graph, or an initial guess is unknown.
        OptimizationError
            If the optimizer or the loss is unknown, a limit is negative, or `trusted` has not one
            entry an edge.
        """
        return solve_partition(
            self.folder,
            self.index,
            method=optimizer,
            init=init,
            loss=loss,
            scale=scale,
            trusted=trusted,
            restart=restart,
            client=client,
            memory=memory,
            threads=threads,
            max_iterations=max_iterations,
            relative_tolerance=relative_tolerance,
            report=report,
        )

    def status(self) -> Checkpoint | None:
        """Return how far the solve is; None before it has begun."""
        return read_checkpoint(self.folder, self.index.graph)

    def costs(self) -> list[Cost]:
        """Return what an iteration costs on one worker, on two, on four and so on.

        It follows from the assembly trees: nothing is solved.
        """
        return table(self.index)

    def poses(self) -> tuple[Ids, Floats]:
        """Return the ids, ascending, and the poses of the lowest chi2 so far.

        Without a solve, the poses are those of the graph. Nodes without an edge are left out.

        Returns
        -------
        ids : ndarray of int64, (n,)
        poses : ndarray of float64, (n, 3) or (n, 7)
            Meters and radians, as of `PoseGraph.poses`.
        """
        nodes = nodes_of(self.index, self._pieces())
        return nodes.ids[~nodes.is_point], nodes.poses[~nodes.is_point]

    def points(self) -> tuple[Ids, Floats]:
        """Return the ids, ascending, and the positions of the landmarks at the lowest chi2 so far.

        Returns
        -------
        ids : ndarray of int64, (k,)
        positions : ndarray of float64, (k, 2) or (k, 3)
            Meters.
        """
        nodes = nodes_of(self.index, self._pieces())
        at = nodes.is_point
        return nodes.ids[at], nodes.poses[at, : self.index.dimension]

    def graph(self) -> PoseGraph:
        """Return the whole graph at the poses of the lowest chi2 so far, in this process' memory.

        Nodes without an edge are not part of it.
        """
        return graph_of(self.index, self._pieces())

    def _pieces(self) -> Iterator[tuple[Piece, Floats]]:
        checkpoint = self.status()
        if checkpoint is None and not self.index.with_poses:
            raise PartitionError(f"{self.folder}: has no poses yet: solve it first")
        name = GIVEN if checkpoint is None else checkpoint.poses
        for entry in self.index.pieces:
            piece = read_piece(self.folder / entry.file, self.index.graph, entry.hash)
            yield piece, read_poses(str(self.folder), name, entry.file, piece)


def partition(
    graph: PoseGraph,
    folder: str | os.PathLike[str],
    parts: int | None = None,
    *,
    labels: ArrayLike | None = None,
) -> Partition:
    """Cut a graph into parts and write each to a file, to be solved part by part.

    The nodes between the parts are separators, which form a tree. `Partition.solve` eliminates
    the parts independently, then the separators from the leaves of that tree up.

    Parameters
    ----------
    graph : PoseGraph
        A graph. With priors, landmarks or edges of partial information it gets an initial guess
        here if it has none.
    folder : path-like
        A folder that is empty, or is made.
    parts : int, optional
        The number of parts; METIS (the package pymetis) cuts the graph.
    labels : array_like of int, (n,), optional
        In the place of `parts`, the part of each node in the order of `graph.ids`, from 0, such as
        the session that it belongs to. Parts with close numbers should be neighbors in the map.

    Returns
    -------
    Partition

    Raises
    ------
    PartitionError
        If the folder is not empty, the graph cannot be cut as asked, or pymetis is missing.
    """
    write_partition(graph, folder, parts, labels)
    return Partition(folder)
