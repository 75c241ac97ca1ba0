"""The steps of a map that grows: an update, what follows from closures and priors, and reviews."""

from __future__ import annotations

import threading
from time import perf_counter

import numpy as np

from masat import _core
from masat.arrays import Ids
from masat.errors import GraphError, MasatError, OptimizationError
from masat.freedoms import degrees_of_freedom
from masat.graph import PoseGraph
from masat.initializers import guess_of
from masat.initializers.triangulation import is_plausible
from masat.online.arrivals import Arrivals
from masat.online.contents import graph_of, poses_of_nodes, roots_of
from masat.online.review import Found, Review, Snapshot, in_frame, kept_rows, snapshot
from masat.online.schedule import Schedule
from masat.online.takeover import outcome_of
from masat.online.update import Update
from masat.online.waiting import Waiting
from masat.optimizers import Result, optimize

_NO_BUDGET = 1e9
# A change of chi2 by less is below what two runs of an optimizer agree in.
_OPTIMUM = 1e-13
# Growth of chi2 after which Gauss-Newton may have led to a place far off.
_MUCH = 2.0


class Steps:
    """What a map that grows consists of, and how it goes from one state to the next.

    Parameters
    ----------
    dimension, tolerance, robust
        As of `masat.OnlineMap`, whose public methods call these; one at a time may change the map.
    """

    def __init__(self, dimension: int, tolerance: float, *, robust: bool) -> None:
        self._dimension, self._tolerance = dimension, tolerance
        self._core = self._new_core()
        self._writing = threading.RLock()
        self._arrivals = Arrivals(self._dimension) if robust else None
        self._waiting = Waiting(self._dimension)
        # Numbers of edges that the current step removes from the core.
        self._removed: list[Ids] = []
        self._schedule = Schedule()
        self._review: Review | None = None
        # chi2 when an initial guess was tried last, since Gauss-Newton may have led far off.
        self._chi2_of_guess = 0.0

    def _new_core(self) -> _core.OnlineMap:
        return _core.OnlineMap(self._dimension, self._tolerance)

    @property
    def _nodes(self) -> int:
        # The world is one of the core's nodes. Another thread may read while landmarks are added.
        core = self._core
        nodes = core.nodes()
        if core.point_count():
            nodes = int(np.count_nonzero(~core.points()))
        return nodes - 1

    def _advanced(self, budget: float | None) -> Update:
        """Bring the map up to date, whatever a review may say."""
        begin = perf_counter()
        if self._removed:
            if self._core.has_sensor_edges():
                removed = np.concatenate(self._removed)
                self._waiting.take_out_undetermined(self._core, removed)
            self._removed.clear()
        try:
            done = self._updated(budget)
        except OptimizationError:
            self._waiting.forget_new(self._core)
            if self._arrivals is not None:
                self._arrivals.forget_new()
            raise
        self._waiting.commit(self._core)
        while self._waiting.release(self._core):
            try:
                done = done.followed_by(self._updated(budget))
            except OptimizationError:
                self._waiting.take_back()
                break
            self._waiting.commit(self._core)
        if self._arrivals is not None:
            self._arrivals.commit()
            left = None if budget is None else max(budget - (perf_counter() - begin), 0.0)
            done = self._with_judged(self._arrivals, done, left)
        self._schedule.count(done.turned)
        return done

    def _updated(self, budget: float | None) -> Update:
        try:
            done = Update(*self._core.update(_NO_BUDGET if budget is None else float(budget)))
        except _core.UndeterminedError as error:
            raise undetermined(error, "what was added since the last update is forgotten") from None
        if done.complete or budget is not None:
            return done
        # Gauss-Newton, which all this is, does not converge from everywhere, and may have led far.
        result = self._to_optimum()
        if not result.converged or self._may_be_far_off(result):
            result = self._to_optimum_from_a_guess(result)
        return done._replace(chi2=result.chi2, complete=result.converged)

    def _may_be_far_off(self, result: Result) -> bool:
        """Whether the map is not good, and has measurements from which Gauss-Newton may go far.

        A map with wrong measurements is never good: it is if chi2 has not grown much since the
        last initial guess.
        """
        if not self._core.has_sensor_edges() or result.chi2 < _MUCH * self._chi2_of_guess:
            return False
        return not is_plausible(result.chi2, degrees_of_freedom(result.graph))

    def _to_optimum_from_a_guess(self, result: Result) -> Result:
        """Move the map to the optimum from an initial guess of its own, if that is better."""
        try:
            found = optimize(guess_of(self._graph(), "chordal"), relative_tolerance=_OPTIMUM)
        except MasatError:
            return result
        self._chi2_of_guess = min(found.chi2, result.chi2)
        if not found.chi2 < result.chi2:
            return result
        self._move_to(found.graph, fixed_stay=True)
        return found

    def _with_judged(self, arrivals: Arrivals, done: Update, budget: float | None) -> Update:
        """Judge the closures that have just arrived, and add those that are believed."""
        believed = arrivals.judge(self._core)
        if len(believed):
            number, ids, z, w = (
                np.array(believed[name]) for name in ("number", "ids", "measurement", "information")
            )
            self._core.add_edges(ids, z, w, number)
            try:
                done = done.followed_by(self._updated(budget))
            except OptimizationError:
                arrivals.compare(self._core, believed)
        # For lack of time a true closure may not fit yet.
        if done.complete:
            far = arrivals.drop_far(self._core)
            if len(far):
                self._core.remove_edges(far)
                done = done.followed_by(self._updated(budget))
        return done

    def _begin_review(self) -> None:
        """Begin a review of the whole map, if it is time."""
        if self._schedule.is_time(self._nodes, self._doubted):
            due = self._schedule.begin(self._nodes, self._doubted)
            self._review = Review(self._snapshot(), due)

    @property
    def _doubted(self) -> int:
        return 0 if self._arrivals is None else self._arrivals.doubted

    def _end_review(self) -> Update | None:
        """Take over the outcome of the review, if there is one."""
        review, self._review = self._review, None
        return None if review is None else self._take_over(review.seen, review.outcome())

    def _snapshot(self) -> Snapshot:
        contents, arrivals = self._core.contents(), self._arrivals
        if arrivals is None:
            return snapshot(contents)
        left_out = arrivals.edges(arrivals.present & ~arrivals.kept)
        return snapshot(contents, left_out, arrivals.rows["number"], self._waiting.rejected)

    def _take_over(self, seen: Snapshot, found: Found) -> Update | None:
        """Make the map that a review found, if it is another one and can be made."""
        decision = found.decision
        changed = 0
        if decision is not None:
            changed = int(np.count_nonzero(decision.kept != seen.believed))
            changed += int(np.count_nonzero(kept_rows(seen, decision) != seen.believed_rows))
        self._schedule.end(changed, 0 if self._arrivals is None else len(self._arrivals))
        if found.poses is None:
            return None
        before = self._core, self._arrivals, self._waiting
        contents, arrivals, waiting = outcome_of(*before, seen, found)
        core = self._new_core()
        try:
            core.fill(**contents)
            core.start_from(contents["poses"])
            done = Update(*core.update(_NO_BUDGET))
        except _core.UndeterminedError:
            return None
        if not changed and core.exact_chi2() >= self._core.exact_chi2():
            # It was better when the review began.
            return None
        self._core, self._arrivals, self._waiting = core, arrivals, waiting
        if not done.complete:
            try:
                result = self._to_optimum()
            except OptimizationError:
                self._core, self._arrivals, self._waiting = before
                return None
            done = done._replace(chi2=result.chi2, complete=result.converged)
        return done._replace(turned=0.0)

    def _graph(self) -> PoseGraph:
        """Return the map after the last update."""
        contents = self._core.contents()
        ids: Ids = contents["ids"]
        if self._nodes == 0:
            raise GraphError("the map is empty: add poses, and update it")
        roots = np.unique(contents["roots"])
        roots = ids[roots[(roots >= 0) & ~contents["points"][roots]]]
        hidden = self._waiting.hidden[self._waiting.hidden < self._core.nodes()]
        return graph_of(contents, self._core.ids()[hidden]).with_root(roots)

    def _to_optimum(self) -> Result:
        """Optimize the graph, and move the map to its poses."""
        result = optimize(self._graph(), relative_tolerance=_OPTIMUM)
        self._move_to(result.graph)
        return result

    def _move_to(self, graph: PoseGraph, *, fixed_stay: bool = False) -> None:
        """Move the map to the poses of a graph, perhaps in the frame of its fixed nodes."""
        ids, poses = self._core.ids()[1:], self._core.poses()[1:]
        shown = ~self._core.points()[1:] | np.isin(ids, graph.point_ids)
        there = poses_of_nodes(graph, ids[shown])
        if fixed_stay:
            there = in_frame(there, roots_of(graph, ids[shown]), poses[shown])
        poses[shown] = there
        try:
            self._core.set_poses(poses)
        except _core.UndeterminedError as error:
            raise undetermined(error, "the poses are as before") from None


def undetermined(error: Exception, outcome: str) -> OptimizationError:
    """Return the error of an update that cannot be done."""
    return OptimizationError(
        f"the edges around node {error.args[0]} do not determine its pose, up to rounding: "
        f"{outcome}; look for information that is nearly singular, and for huge numbers"
    )
