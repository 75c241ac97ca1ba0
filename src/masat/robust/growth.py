"""Closures are believed one after the other, the most likely first."""

from __future__ import annotations

import numpy as np

from masat.arrays import Flags, Floats, Ids, Indices
from masat.initializers import guess_of
from masat.optimizers import optimize
from masat.progress import Progress
from masat.residuals import chi2_per_edge
from masat.robust.closures import FAR_GATE, GATE, REACH, Closures, connected
from masat.robust.prediction import agreement, predict

# A closure that no other supports needs a larger likelihood ratio, in logarithms.
_MIN_RATIO, _MIN_RATIO_ALONE = 1.0, 6.0
_TOLERANCE, _ITERATIONS = 1e-5, 30
_MAX_ROUNDS, _MAX_REFINEMENTS = 200, 5
# Nodes from an end of a new closure within which predictions are made again at once.
_NEAR = 5 * REACH
# Squared distances beyond this many gates are not looked at again until nothing else is left.
_HOPELESS = 100.0


class Growth:
    """A map that grows by the closures that it predicts best.

    It begins with the trusted edges alone. Each round predicts the closures from the map
    (`prediction.predict`), believes the likelier half of those within the gate, optimizes, and
    drops what then is far beyond its information. False closures that are never believed do not
    enter a system.

    Parameters
    ----------
    closures : Closures
        The closures.
    progress : Progress
        What reports the stages and limits the time.
    """

    def __init__(self, closures: Closures, progress: Progress) -> None:
        self._closures = closures
        self._progress = progress
        graph = closures.graph
        trusted = graph.without_edges(~closures.trusted)
        guess = guess_of(trusted, "chordal").poses
        assert guess is not None
        self.poses: Floats = guess
        self.kept: Flags = np.zeros(len(closures), np.bool_)
        self.banned: Flags = np.zeros(len(closures), np.bool_)
        self.distance = np.full(len(closures), np.inf)
        self.log_ratio = np.full(len(closures), -np.inf)
        self._optimize()
        agree = closures.pairs[agreement(closures, self.poses) < GATE[graph.dof]]
        self.supported: Flags = np.zeros(len(closures), np.bool_)
        self.supported[agree.ravel()] = True
        # Closures that agree, by way of others: they are likely all true or all false.
        self.runs: Indices = connected(len(closures), agree)

    @property
    def chi2(self) -> Floats:
        """chi2 of each edge of the whole graph at the poses of the map, (m,)."""
        return chi2_per_edge(self._closures.graph, self.poses)

    def grow(self) -> Floats:
        """Believe closures until the map predicts no other; return their first distances, (c,)."""
        self._predict(np.flatnonzero(~self.kept))
        first = self.distance.copy()
        fresh = True
        for _ in range(_MAX_ROUNDS):
            if self._progress.over:
                return first
            likely = self._likely()
            if len(likely) == 0:
                if fresh:
                    break
                self._predict(np.flatnonzero(~self.kept))
                fresh = True
                continue
            new = likely[: (len(likely) + 1) // 2]
            self._progress.tell(f"believing {int(self.kept.sum()) + len(new)} loop closures")
            self.believe(new)
            self._predict(self._near(new))
            fresh = False
        self._refine()
        return first

    def believe(self, new: Ids) -> None:
        """Add closures to the map, and drop those that are then far beyond their information."""
        before = self.kept.copy(), self.poses
        try:
            self.kept[new] = True
            self._optimize()
            far = self.kept & (self.chi2[self._closures.edges] > FAR_GATE[self._closures.graph.dof])
            if far.any():
                self.kept &= ~far
                self._optimize()
        except BaseException:
            # What was not checked is not believed.
            self.kept, self.poses = before
            raise

    def disbelieve(self, old: Ids) -> None:
        """Take closures out of the map for good."""
        self.kept[old] = False
        self.banned[old] = True
        self._optimize()

    def count_likely(self) -> int:
        """Return how many of the closures that agree with others the map would now believe."""
        self._predict(np.flatnonzero(~self.kept & ~self.banned & self.supported & ~self._hopeless))
        return len(self._likely())

    @property
    def _hopeless(self) -> Flags:
        """Closures so far from their prediction that they are looked at last, (c,)."""
        return self.distance > _HOPELESS * GATE[self._closures.graph.dof]

    def copy(self) -> Growth:
        """Return a growth that can be tried without changing this one."""
        other = object.__new__(Growth)
        other.__dict__.update(self.__dict__)
        for name in ("kept", "banned", "distance", "log_ratio"):
            setattr(other, name, getattr(self, name).copy())
        return other

    def _likely(self) -> Ids:
        """Return the closures to believe next, the most likely first."""
        needed = np.where(self.supported, _MIN_RATIO, _MIN_RATIO_ALONE)
        within = self.distance < GATE[self._closures.graph.dof]
        likely = np.flatnonzero(~self.kept & ~self.banned & within & (self.log_ratio > needed))
        return likely[np.argsort(-self.log_ratio[likely], kind="stable")]

    def _near(self, new: Ids) -> Ids:
        """Return the closures near new ones that are not hopeless."""
        n = len(self._closures.graph)
        ends = self._closures.ends[new].ravel()
        begun = np.bincount(np.maximum(ends - _NEAR, 0), minlength=n + 1)
        ended = np.bincount(np.minimum(ends + _NEAR + 1, n), minlength=n + 1)
        touched = np.cumsum(begun - ended)[:n] > 0
        here = touched[self._closures.ends].any(axis=1)
        return np.flatnonzero(~self.kept & here & ~self._hopeless)

    def _predict(self, chosen: Ids) -> None:
        if len(chosen):
            found = predict(self._closures, self.kept, self.poses, chosen)
            self.distance[chosen], self.log_ratio[chosen] = found

    def _refine(self) -> None:
        """Keep exactly the closures within the gate of the map that they make."""
        dof = self._closures.graph.dof
        for _ in range(_MAX_REFINEMENTS):
            within = self.kept & (self.chi2[self._closures.edges] < GATE[dof])
            if (within == self.kept).all() or self._progress.over:
                return
            self.kept = within
            self._optimize()

    def _optimize(self) -> None:
        result = optimize(
            self._closures.graph_with(self.kept, self.poses),
            "dogleg",
            max_iterations=_ITERATIONS,
            relative_tolerance=_TOLERANCE,
        )
        self.poses = result.poses
