"""The map that grows: what a front end adds to it, and what it reads of it."""

from __future__ import annotations

import os
import threading
from pathlib import Path
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike

from masat import _checks as checks
from masat import _core, lie
from masat.arrays import Floats, Ids, Indices
from masat.covariance import relative_from_blocks
from masat.errors import GraphError, OptimizationError
from masat.graph import PoseGraph
from masat.online.additions import are_plain, checked_edges, checked_guess, checked_id
from masat.online.files import read_map, write_map
from masat.optimizers import Result, optimize

# Measured on seven public graphs (benchmarks/online.py): chi2 is then 1.5e-4 above the optimum of a
# step in the mean.
_TOLERANCE = 1.5e-4
_NO_BUDGET = 1e9
# A change of chi2 by less is below what two runs of an optimizer agree in.
_OPTIMUM = 1e-13


class Update(NamedTuple):
    """What one update of an `OnlineMap` did.

    Attributes
    ----------
    chi2 : float
        Sum over the edges of e' W e after it, approximately: edges whose poses hardly moved are not
        evaluated again. `OnlineMap.chi2` is exact.
    refactored : int
        Nodes that were eliminated again.
    relinearized : int
        Nodes whose edges were linearized again.
    changed : int
        Nodes that moved, however little.
    passes : int
        How often the equations were solved.
    complete : bool
        Whether the tolerance was reached. If not, for lack of time, the next update goes on.
    """

    chi2: float
    refactored: int
    relinearized: int
    changed: int
    passes: int
    complete: bool


class OnlineMap:
    """A map of which poses and edges become known one after the other.

    A front end adds a pose and its edges, calls `update`, and reads the poses: each step changes
    only what its edges change, and costs a small fraction of a solve. `graph` returns the map as an
    immutable `PoseGraph`, and `optimize` takes it to the exact optimum.

    One node of each connected component is fixed, the one that was added first. Where an edge joins
    two components, the one whose fixed node is older stays where it is. The other is moved as a
    whole to where the edge puts it, and its fixed node is optimized from then on. A new pose is
    such a component: its first edge places it.

    One thread may change the map while any number of others read `poses`, `pose` and `ids`: they
    get the state after the last complete update and never wait for one.

    Parameters
    ----------
    dimension : int
        2 for poses (x, y, theta), 3 for poses (x, y, z, qx, qy, qz, qw): meters, radians, unit
        quaternions.
    tolerance : float
        Fraction of chi2 by which that of the estimate may exceed the optimum, as far as first-order
        bounds tell. Smaller values cost more; 0 solves each step as exactly as rounding allows.

    Raises
    ------
    GraphError
        If the dimension is neither 2 nor 3.
    OptimizationError
        If the tolerance is not in [0, 1).

    Notes
    -----
    The factor is a multifrontal Cholesky whose fronts are computed again on the paths from what
    changed to the roots, as the cliques of the Bayes tree of Kaess, Johannsson, Roberts, Ila,
    Leonard, Dellaert, iSAM2: Incremental smoothing and mapping using the Bayes tree, IJRR 2012. An
    edge is linearized again when what its linearization neglects, in the units of chi2, matters.

    Examples
    --------
    >>> import masat
    >>> world = masat.OnlineMap(2)
    >>> for k in range(4):
    ...     world.add_pose(k)
    ...     if k > 0:
    ...         _ = world.add_edges((k - 1, k), (1, 0, 1.6))
    ...     _ = world.update()
    >>> _ = world.add_edges((3, 0), (1, 0, 1.6))
    >>> round(world.update().chi2, 4)
    0.0034
    """

    def __init__(self, dimension: int, *, tolerance: float = _TOLERANCE) -> None:
        if dimension not in lie.DOF:
            raise GraphError(f"the dimension must be 2 or 3, got {dimension!r}")
        if not 0 <= tolerance < 1:
            raise OptimizationError(f"the tolerance must be in [0, 1), got {tolerance!r}")
        self._dimension, self._tolerance = int(dimension), float(tolerance)
        self._core = _core.OnlineMap(self._dimension, self._tolerance)
        self._writing = threading.RLock()

    def __len__(self) -> int:
        return self._core.nodes()

    def __repr__(self) -> str:
        return f"OnlineMap({self._dimension}D, {len(self)} nodes, {self._core.edges()} edges)"

    @property
    def dimension(self) -> int:
        """2 or 3."""
        return self._dimension

    @property
    def tolerance(self) -> float:
        """Fraction of chi2 by which that of the estimate may exceed the optimum."""
        return self._tolerance

    def add_pose(self, node: int, guess: ArrayLike | None = None) -> None:
        """Add a pose, which becomes part of the map at the next `update`.

        Parameters
        ----------
        node : int
            Its id, any integer of 64 bits that no pose has yet.
        guess : array_like, (3,) or (7,), optional
            Where it is, approximately. Default: its first edge places it. A pose that is the first
            of its component stays at its guess, by default the identity.

        Raises
        ------
        GraphError
            If the id is taken or is no integer, or if the guess is no pose. The map is unchanged.
        """
        with self._writing:
            node = checked_id(node)
            pose = None if guess is None else checked_guess(guess, node, self._dimension)
            if not self._core.add_node(node, pose):
                raise GraphError(f"the map has a node {node} already")

    def add_edges(
        self,
        edges: ArrayLike,
        measurements: ArrayLike,
        information: ArrayLike | None = None,
    ) -> Ids:
        """Add edges, which become part of the map at the next `update`.

        Parameters
        ----------
        edges : array_like of int, (m, 2) or (2,)
            Ids (from, to) of poses that have been added.
        measurements : array_like, (m, 3) or (m, 7), or one row
            Pose of `to` in the frame of `from`, as measured.
        information : array_like, (m, d, d) or (d, d), optional
            Inverse covariances, one an edge or one for all, symmetric positive definite, in the
            order of g2o: x, y, theta, or translation and vector part of the quaternion. Default:
            the identity.

        Returns
        -------
        ndarray of int64, (m,)
            The numbers of the edges, by which `remove_edges` knows them: 0, 1, 2, ... in the order
            in which they are added.

        Raises
        ------
        GraphError
            If an id is unknown, if an edge joins a node to itself, if numbers are not finite, or if
            shapes do not fit. The map is unchanged, as after the next one.
        InformationError
            If information is not symmetric positive definite.
        """
        with self._writing:
            first = self._core.next_edge()
            if not (
                are_plain(edges, measurements, information, self._dimension)
                and self._core.add_edges(edges, measurements, information)  # type: ignore[arg-type]
            ):
                checked = checked_edges(
                    self._core, edges, measurements, information, self._dimension
                )
                if not self._core.add_edges(*checked):
                    raise GraphError("the edges cannot be added: their numbers are too large")
            return np.arange(first, self._core.next_edge())

    def remove_edges(self, numbers: int | ArrayLike) -> None:
        """Remove edges at the next `update`; nodes that lose all their edges remain.

        Where a component falls apart, the node of the new part that was added first is fixed at its
        pose.

        Parameters
        ----------
        numbers : int or array_like of int, (k,)
            Numbers of edges, as `add_edges` returned them.

        Raises
        ------
        GraphError
            If there is no such edge, or if one is named twice. The map is unchanged.
        """
        wanted = np.atleast_1d(checks.integers("numbers of edges", numbers))
        if wanted.ndim != 1:
            raise GraphError(f"numbers of edges must have shape (k,), got {wanted.shape}")
        with self._writing:
            if not self._core.remove_edges(wanted):
                for number in wanted:
                    if not self._core.has_edge(int(number)):
                        raise GraphError(f"the map has no edge {number}, or it is removed already")
                raise GraphError("an edge is named twice among those to be removed")

    def update(self, budget: float | None = None) -> Update:
        """Bring the map up to date with all that was added and removed.

        Parameters
        ----------
        budget : float, optional
            Seconds after which nothing more is linearized again; the next update goes on with it.
            What is new is always part of the estimate, and the estimate complete. Default: no
            limit.

        Returns
        -------
        Update
            What was done.

        Raises
        ------
        OptimizationError
            If the edges do not determine a pose, up to rounding. What was added and removed since
            the last update is forgotten then, and the map is as before. If the budget is negative,
            nothing is done.
        """
        if budget is not None and not budget >= 0:
            raise OptimizationError(f"the budget must not be negative, got {budget}")
        with self._writing:
            try:
                done = Update(*self._core.update(_NO_BUDGET if budget is None else float(budget)))
            except _core.UndeterminedError as error:
                raise _undetermined(
                    error, "what was added since the last update is forgotten"
                ) from None
            if done.complete or budget is not None:
                return done
            # Gauss-Newton, which all this is, does not converge from everywhere.
            result = self._to_optimum()
            return done._replace(chi2=result.chi2, complete=result.converged)

    @property
    def ids(self) -> Ids:
        """Ids of the poses, (n,), in the order in which they were added."""
        return self._core.ids()

    @property
    def poses(self) -> Floats:
        """The poses after the last update, (n, 3) or (n, 7), in the order of `ids`; a copy."""
        return self._core.poses()

    def pose(self, node: int) -> Floats:
        """Return one pose after the last update, (3,) or (7,); an unknown id is a GraphError."""
        pose = self._core.pose(checked_id(node))
        if pose is None:
            raise GraphError(f"the map has no node {node}")
        return pose

    @property
    def chi2(self) -> float:
        """Sum over the edges of e' W e at the poses."""
        with self._writing:
            return self._core.exact_chi2()

    def covariances(self, ids: ArrayLike | None = None) -> Floats:
        """Return the marginal covariances of poses, from the factor of the last update.

        Parameters
        ----------
        ids : array_like of int, (k,), optional
            Ids of poses. Default: all, in the order of `ids`.

        Returns
        -------
        ndarray, (k, 3, 3) or (k, 6, 6)
            In order, units and frames those of `masat.covariances`, at the poses at which the edges
            were linearized, which are near the current ones. Fixed nodes have covariance zero.

        Raises
        ------
        GraphError
            If an id is unknown.

        Notes
        -----
        Each pose costs one solve along its path to the root of the factor (Kaess and Dellaert,
        Robotics and Autonomous Systems 2009), so a few cost little; for all `masat.covariances` of
        `graph()` is faster.
        """
        with self._writing:
            indices = self._indices(self.ids if ids is None else ids, 1)
            return self._core.covariances(indices, indices)

    def relative_covariances(self, pairs: ArrayLike) -> Floats:
        """Return the covariances of poses relative to others, from the factor of the last update.

        They say how likely a loop closure is before it is tried.

        Parameters
        ----------
        pairs : array_like of int, (k, 2)
            Ids (a, b).

        Returns
        -------
        ndarray, (k, 3, 3) or (k, 6, 6)
            Covariance of a^-1 b, as `masat.relative_covariances` returns it.

        Raises
        ------
        GraphError
            If an id is unknown.
        """
        with self._writing:
            a, b = (np.ascontiguousarray(end) for end in self._indices(pairs, 2).T)
            of_a, of_b, joint = self._core.covariances(
                np.concatenate([a, b, a]), np.concatenate([a, b, b])
            ).reshape(3, len(a), lie.DOF[self._dimension], lie.DOF[self._dimension])
            where = self._core.linearized(np.concatenate([a, b]))
            return relative_from_blocks(of_a, of_b, joint, where[: len(a)], where[len(a) :])

    def graph(self) -> PoseGraph:
        """Return the map after the last update as an immutable graph with poses.

        Its edges are in the order of their numbers, and its gauge-fixed nodes are those of the map.

        Raises
        ------
        GraphError
            If the map has no pose.
        """
        with self._writing:
            contents = self._core.contents()
        ids: Ids = contents["ids"]
        if len(ids) == 0:
            raise GraphError("the map is empty: add poses, and update it")
        graph = PoseGraph.from_arrays(
            contents["edges"],
            contents["measurements"].reshape(-1, lie.POSE_SIZE[self._dimension]),
            contents["information"],
            ids=ids,
            poses=contents["poses"],
        )
        return graph.with_root(ids[np.unique(contents["roots"])])

    def optimize(self) -> Result:
        """Take the map to the optimum that `masat.optimize` finds from its poses.

        Returns
        -------
        Result
            That of `masat.optimize`; the map has its poses.

        Raises
        ------
        GraphError
            If the map has no pose.
        OptimizationError
            As of `update`, which is called first.
        """
        with self._writing:
            self.update()
            return self._to_optimum()

    def _to_optimum(self) -> Result:
        """Optimize the graph, and move the map to its poses."""
        result = optimize(self.graph(), relative_tolerance=_OPTIMUM)
        poses = result.poses[result.graph.index(self.ids)]
        try:
            self._core.set_poses(poses)
        except _core.UndeterminedError as error:
            raise _undetermined(error, "the poses are as before") from None
        return result

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the map after the last update to an .npz file, whole or not at all."""
        with self._writing:
            contents = self._core.contents()
        write_map(Path(path), self._dimension, self._tolerance, contents)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Self:
        """Read a map that `save` wrote; it goes on where the other was.

        Raises
        ------
        FormatError
            If the file holds something else.
        """
        dimension, tolerance, contents = read_map(Path(path))
        out = cls(dimension, tolerance=tolerance)
        try:
            out._core.fill(**contents)
        except _core.UndeterminedError as error:
            raise _undetermined(error, "the file cannot be used") from None
        return out

    def _indices(self, ids: ArrayLike, ndim: int) -> Indices:
        """Return the indices of ids, of a row or of pairs."""
        wanted = checks.integers("ids", ids)
        if ndim == 2 and wanted.size == 0:
            wanted = wanted.reshape(0, 2)
        if wanted.ndim != ndim or (ndim == 2 and wanted.shape[1] != 2):
            raise GraphError(
                f"{'pairs' if ndim == 2 else 'ids'} must have shape "
                f"{'(k, 2)' if ndim == 2 else '(k,)'}, got {wanted.shape}"
            )
        indices = self._core.find_all(wanted.ravel()).reshape(wanted.shape)
        for unknown in wanted[indices < 0][:1]:
            raise GraphError(f"the map has no node {unknown}")
        return indices


def _undetermined(error: Exception, outcome: str) -> OptimizationError:
    return OptimizationError(
        f"the edges around node {error.args[0]} do not determine its pose, up to rounding: "
        f"{outcome}; look for information that is nearly singular, and for huge numbers"
    )
