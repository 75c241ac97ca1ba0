"""The map that grows: what a front end adds to it."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from masat import _checks as checks
from masat import _core, lie
from masat.arrays import Ids
from masat.errors import GraphError, OptimizationError
from masat.measurements import Landmarks, Priors
from masat.online.additions import (
    are_plain,
    check_observations,
    check_priors,
    checked_edges,
    checked_guess,
    checked_id,
)
from masat.online.files import read_map, write_map
from masat.online.reading import Reading
from masat.online.review import look_again
from masat.online.sensor_rows import rows_of_observations, rows_of_priors
from masat.online.steps import undetermined
from masat.online.update import Update
from masat.optimizers import Result
from masat.residuals import as_poses

# Measured on seven public graphs (benchmarks/online.py): chi2 is then 1.5e-4 above the optimum of a
# step in the mean.
TOLERANCE = 1.5e-4


class OnlineMap(Reading):
    """A map of which poses and edges become known one after the other.

    A front end adds a pose, its edges and what it saw of landmarks, calls `update`, and reads the
    poses: each step changes only what its measurements change, and costs a small fraction of a
    solve. `graph` returns the map as an immutable `PoseGraph`, and `optimize` takes it to the exact
    optimum.

    One pose of each connected component is fixed, the one that was added first. Where an edge joins
    two components, the one whose fixed node is older stays where it is. The other is moved as a
    whole to where the edge puts it, and its fixed node is optimized from then on. A new pose is
    such a component: its first edge places it.

    One thread may change the map while any number of others read `poses`, `pose`, `ids`, `points`,
    `point` and `point_ids`: they get a complete estimate, never a half-made one, and never wait for
    an update.

    If an update turns poses far, which may have led to a wrong minimum, the whole map is solved on
    another thread, from an initial guess of its own, while it grows on. So it is when many closures
    have been rejected, to decide on all of them together. The outcome is taken over a number of
    updates later that depends on the size of the map alone, so that the same input gives the same
    map; only where the machine is too slow for that, an update waits.

    Parameters
    ----------
    dimension : int
        2 for poses (x, y, theta), 3 for poses (x, y, z, qx, qy, qz, qw): meters, radians, unit
        quaternions.
    tolerance : float
        Fraction of chi2 by which that of the estimate may exceed the optimum, as far as first-order
        bounds tell. Smaller values cost more; 0 solves each step as exactly as rounding allows.
    robust : bool
        Whether to judge each loop closure when it arrives: one that contradicts the map, or that is
        as likely false as true, is left out. `closures` and `rejected` tell what was thought of it.
        Trusted are the edges that are the first of a node, as odometry is. Priors and
        observations of landmarks are not judged until all is decided on together.

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

    def __init__(
        self, dimension: int, *, tolerance: float = TOLERANCE, robust: bool = False
    ) -> None:
        if dimension not in lie.DOF:
            raise GraphError(f"the dimension must be 2 or 3, got {dimension!r}")
        if not 0 <= tolerance < 1:
            raise OptimizationError(f"the tolerance must be in [0, 1), got {tolerance!r}")
        super().__init__(int(dimension), float(tolerance), robust=robust)

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
        *,
        trusted: bool | None = None,
    ) -> Ids:
        """Add edges, which become part of the map at the next `update`.

        A robust map then judges loop closures first, and may leave them out.

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
        trusted : bool, optional
            Whether these edges are believed in any case, in a robust map. Default: those are that
            are the first of one of their nodes, as odometry is.

        Returns
        -------
        ndarray of int64, (m,)
            The numbers of the edges, by which `remove_edges` knows them: 0, 1, 2, ... in the order
            in which they are added.

        Raises
        ------
        GraphError
            If an id is unknown, if an edge joins a node to itself, if numbers are not finite, if
            shapes do not fit, or if `trusted` is neither a bool nor None. The map is unchanged, as
            after the next one.
        InformationError
            If information is not symmetric positive definite.
        """
        if trusted is not None and not isinstance(trusted, bool | np.bool_):
            raise GraphError(f"trusted must be True, False or None, got {trusted!r:.40}")
        with self._writing:
            first = self._core.next_edge()
            rows: tuple[Any, Any, Any] = edges, measurements, information
            if not (are_plain(*rows, dimension=self._dimension) and self._core.add_edges(*rows)):
                rows = checked_edges(self._core, *rows, dimension=self._dimension)
                if not self._core.add_edges(*rows):
                    raise GraphError("the edges cannot be added: their numbers are too large")
            numbers = np.arange(first, self._core.next_edge())
            if self._arrivals is not None:
                self._arrivals.withhold(self._core, numbers, *rows, trusted=trusted)
            return numbers

    def add_priors(self, priors: Priors) -> Ids:
        """Add position fixes and other priors, which become part of the map at an `update`.

        A part of the map that has no prior lies in a frame of its own. Its priors wait until they
        determine where it lies in the world to about ten degrees. Then the part is moved onto them
        as a whole, and none of its poses is fixed any more.

        Parameters
        ----------
        priors : Priors
            On poses and landmarks that have been added, from `masat.gps` and the like.

        Returns
        -------
        ndarray of int64, (p,)
            Their numbers, by which `remove_edges` knows them: they are counted with the edges.

        Raises
        ------
        GraphError
            If a node is unknown, if the priors are of another dimension, or if one on a landmark
            measures a rotation. The map is unchanged.
        """
        with self._writing:
            check_priors(self._core, priors, self._dimension)
            return self._waiting.add(self._core, rows_of_priors(priors))

    def add_observations(self, seen: Landmarks) -> Ids:
        """Add landmarks and what poses saw of them, which become part of the map at an `update`.

        The first observation that determines the position of a landmark places it. Of ranges alone
        or bearings alone, several are needed: they wait until together they determine it. So do
        observations of a landmark of another part of the map, until they determine how the parts
        lie to each other to about ten degrees; then the newer part is moved as a whole.

        Parameters
        ----------
        seen : Landmarks
            Observations from poses that have been added, from `masat.landmarks` and
            `masat.range_bearing`. Positions that it has are where new landmarks begin.

        Returns
        -------
        ndarray of int64, (l,)
            The numbers of the observations, by which `remove_edges` knows them: they are counted
            with the edges.

        Raises
        ------
        GraphError
            If a pose is unknown, if a landmark has the id of a pose, or if the landmarks are of
            another dimension. The map is unchanged.
        """
        with self._writing:
            check_observations(self._core, seen, self._dimension)
            rows = rows_of_observations(seen)
            new = []
            for k, node in enumerate(seen.ids.tolist()):
                if self._core.find(node) >= 0:
                    continue
                where = None if seen.positions is None else as_poses(seen.positions[k : k + 1])[0]
                self._core.add_node(node, where, True)
                if where is None:
                    new.append(self._core.find(node))
            return self._waiting.add(self._core, rows, np.array(new, np.int32))

    def remove_edges(self, numbers: int | ArrayLike) -> None:
        """Remove edges, priors or observations at the next `update`; all nodes remain.

        Where a component falls apart, the pose of the new part that was added first is fixed. So it
        does where what is left does not determine how its parts lie to each other or in the world:
        the priors and observations that join them wait then, until others determine it. A landmark
        that is not determined any more has no position until it is.

        Parameters
        ----------
        numbers : int or array_like of int, (k,)
            Numbers as `add_edges`, `add_priors` and `add_observations` returned them.

        Raises
        ------
        GraphError
            If there is no such edge, or if one is named twice. The map is unchanged.
        """
        wanted = np.atleast_1d(checks.integers("numbers of edges", numbers))
        if wanted.ndim != 1:
            raise GraphError(f"numbers of edges must have shape (k,), got {wanted.shape}")
        with self._writing:
            withheld = self._waiting.withheld(wanted)
            if self._arrivals is not None:
                withheld |= self._arrivals.withheld(wanted)
            twice = len(np.unique(wanted)) < len(wanted)
            if twice or not self._core.remove_edges(wanted[~withheld]):
                for number in wanted[~withheld]:
                    if not self._core.has_edge(int(number)):
                        raise GraphError(f"the map has no edge {number}, or it is removed already")
                raise GraphError("an edge is named twice among those to be removed")
            self._removed.append(wanted[~withheld])
            self._waiting.remove(wanted[withheld])
            if self._arrivals is not None:
                self._arrivals.remove(wanted)

    def update(self, budget: float | None = None) -> Update:
        """Bring the map up to date with all that was added and removed.

        Parameters
        ----------
        budget : float, optional
            Seconds after which nothing more is linearized again; the next update goes on with it.
            What is new is always part of the estimate, and the estimate complete. The outcome of a
            review is taken over as soon as that needs no waiting, which may take longer than the
            budget. Default: no limit.

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
            done = self._advanced(budget)
            if self._review is None:
                self._begin_review()
            elif self._schedule.steps >= self._review.due and (
                budget is None or self._review.is_ready
            ):
                done = done.followed_by(self._end_review() or done)
            return done

    def optimize(self) -> Result:
        """Take the map to the optimum that `masat.optimize` finds from its poses.

        A robust map first decides on all loop closures together, as `masat.solve` does with
        `robust=True`; any other, where poses have turned far, looks for a lower minimum.

        Returns
        -------
        Result
            That of `masat.optimize`; the map has its poses. The `decision` of a robust map is on
            all edges in the order of their numbers.

        Raises
        ------
        GraphError
            If the map has no pose.
        OptimizationError
            As of `update`, which is called first.
        """
        with self._writing:
            self._advanced(None)
            self._end_review()
            if not self._schedule.has_turned and (self._arrivals is None or not self._arrivals):
                return self._to_optimum()
            seen = self._snapshot()
            self._schedule.begin(len(self), self._doubted)
            found = look_again(seen)
            self._take_over(seen, found)
            return replace(self._to_optimum(), decision=found.decision)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the map after the last update to an .npz file, whole or not at all."""
        with self._writing:
            contents = self._core.contents()
            closures = None if self._arrivals is None else self._arrivals.judged()
            contents["waiting"] = self._waiting.rows
        write_map(Path(path), self._dimension, self._tolerance, contents, closures)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Self:
        """Read a map that `save` wrote; it goes on where the other was.

        Raises
        ------
        FormatError
            If the file holds something else.
        """
        dimension, tolerance, contents, closures = read_map(Path(path))
        out = cls(dimension, tolerance=tolerance, robust=closures is not None)
        waiting = contents.pop("waiting")
        try:
            out._core.fill(**contents)
        except _core.UndeterminedError as error:
            raise undetermined(error, "the file cannot be used") from None
        out._waiting.restore(out._core, waiting)
        if out._arrivals is not None and closures is not None:
            out._arrivals.restore(out._core, contents, closures)
        out._schedule.begin(len(out), out._doubted)
        return out
