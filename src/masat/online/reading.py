"""What a front end reads of a map that grows."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from masat import _checks as checks
from masat import _core, lie
from masat.arrays import AnyArray, Floats, Ids, Indices
from masat.covariance import relative_from_blocks
from masat.errors import GraphError
from masat.graph import PoseGraph
from masat.online.additions import checked_id
from masat.online.arrivals import Arrivals
from masat.online.steps import Steps


class Reading(Steps):
    """The properties of `masat.OnlineMap`, and its methods that change nothing."""

    def __len__(self) -> int:
        return self._nodes

    def __repr__(self) -> str:
        edges = f"{len(self)} nodes, {self._core.edges()} edges"
        points = self._core.point_count()
        more = f", {points} landmarks" if points else ""
        return f"OnlineMap({self._dimension}D, {edges}{more})"

    @property
    def dimension(self) -> int:
        """2 or 3."""
        return self._dimension

    @property
    def tolerance(self) -> float:
        """Fraction of chi2 by which that of the estimate may exceed the optimum."""
        return self._tolerance

    @property
    def robust(self) -> bool:
        """Whether loop closures are judged."""
        return self._arrivals is not None

    @property
    def ids(self) -> Ids:
        """Ids of the poses, (n,), in the order in which they were added."""
        core = self._core
        return _poses_among(core, core.ids())

    @property
    def poses(self) -> Floats:
        """The poses after the last update, (n, 3) or (n, 7), in the order of `ids`; a copy."""
        core = self._core
        return _poses_among(core, core.poses())

    def pose(self, node: int) -> Floats:
        """Return one pose after the last update, (3,) or (7,); an unknown id is a GraphError."""
        core = self._core
        pose = core.pose(checked_id(node))
        if pose is None or (core.point_count() and core.is_point(node)):
            raise GraphError(f"the map has no node {node}")
        return pose

    @property
    def point_ids(self) -> Ids:
        """Ids of the landmarks that have a position, (k,), in the order of their addition."""
        return self._points()[0]

    @property
    def points(self) -> Floats:
        """Their positions after the last update, (k, 2) or (k, 3), in the order of `point_ids`."""
        return self._points()[1]

    def point(self, node: int) -> Floats:
        """Return the position of one landmark, (2,) or (3,); one without is a GraphError."""
        ids, points = self._points()
        for point in points[ids == checked_id(node)]:
            return np.array(point)
        raise GraphError(f"the map has no landmark {node}, or its position is not determined yet")

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

    def landmark_covariances(self, ids: ArrayLike | None = None) -> Floats:
        """Return the marginal covariances of landmarks, from the factor of the last update.

        Parameters
        ----------
        ids : array_like of int, (k,), optional
            Ids of landmarks. Default: all, in the order of `point_ids`.

        Returns
        -------
        ndarray, (k, 2, 2) or (k, 3, 3)
            In square meters, along the axes of the map. A landmark that nothing measures any more
            has covariance zero.

        Raises
        ------
        GraphError
            If an id is that of no landmark that has a position.
        """
        with self._writing:
            known = self.point_ids
            wanted = known if ids is None else checks.integers("ids", ids)
            if wanted.ndim != 1:
                raise GraphError(f"ids must have shape (k,), got {wanted.shape}")
            for unknown in wanted[~np.isin(wanted, known)][:1]:
                raise GraphError(
                    f"the map has no landmark {unknown}, or its position is not determined yet"
                )
            indices, d = self._core.find_all(wanted), self._dimension
            # The steps of a node are along its own axes.
            turn = _core.rotation_matrices(self._core.linearized(indices))
            own = self._core.covariances(indices, indices)[:, :d, :d]
            return turn @ own @ turn.transpose(0, 2, 1)

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

    @property
    def waiting_priors(self) -> Ids:
        """The numbers of the priors that do not determine yet where their part of the map lies."""
        return self._waiting.numbers(priors=True, rejected=False)

    @property
    def waiting_observations(self) -> Ids:
        """The numbers of the observations that do not determine yet what they measure."""
        return self._waiting.numbers(priors=False, rejected=False)

    @property
    def closures(self) -> AnyArray:
        """The loop closures of a robust map: a structured array with a row for each.

        `edge` (its number), `from`, `to`, `kept`, `distance` and `log_ratio` (of the measurement
        from its prediction, when it was judged last, as in `masat.robust.Decision`), `reason`.
        """
        with self._writing:
            arrivals = Arrivals(self._dimension) if self._arrivals is None else self._arrivals
            return arrivals.table()

    @property
    def rejected(self) -> Ids:
        """The numbers of the loop closures that are not part of the map, ascending."""
        with self._writing:
            return np.empty(0, np.int64) if self._arrivals is None else self._arrivals.rejected()

    @property
    def rejected_priors(self) -> Ids:
        """The numbers of the priors that a robust map has left out, ascending."""
        return self._waiting.numbers(priors=True, rejected=True)

    @property
    def rejected_observations(self) -> Ids:
        """The numbers of the observations that a robust map has left out, ascending."""
        return self._waiting.numbers(priors=False, rejected=True)

    def graph(self) -> PoseGraph:
        """Return the map after the last update as an immutable graph with poses.

        Its edges are in the order of their numbers, and its gauge-fixed nodes are those of the map.
        It has the edges that are believed, and the priors and observations that do not wait.

        Raises
        ------
        GraphError
            If the map has no pose.
        """
        with self._writing:
            return self._graph()

    def _points(self) -> tuple[Ids, Floats]:
        """Return ids and positions of the landmarks after one and the same update."""
        while True:
            core, hidden = self._core, self._waiting.hidden
            poses = core.poses()
            shown, ids = core.points()[: len(poses)], core.ids()[: len(poses)]
            shown[hidden[hidden < len(poses)]] = False
            if hidden is self._waiting.hidden and core is self._core:
                return ids[shown], poses[shown, : self._dimension]

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
        is_unknown = indices < 0
        if self._core.point_count():
            is_unknown |= self._core.points()[indices]
        for unknown in wanted[is_unknown][:1]:
            raise GraphError(f"the map has no node {unknown}")
        return indices


def _poses_among(core: _core.OnlineMap, nodes: AnyArray) -> AnyArray:
    """Return those rows of an array over the core's nodes that are of poses."""
    if not core.point_count():
        return nodes[1:]
    out: AnyArray = nodes[~core.points()[: len(nodes)]][1:]
    return out
