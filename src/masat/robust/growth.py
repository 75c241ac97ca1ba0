"""Closures are believed one after the other, the most likely first."""

from __future__ import annotations

import numpy as np

from masat import _core
from masat.arrays import Flags, Floats, Ids, Indices
from masat.graph import PoseGraph
from masat.initializers import guess_of
from masat.optimizers import optimize
from masat.optimizers.equations import normal_equations
from masat.progress import Progress
from masat.quantiles import FAR_GATE, GATE
from masat.residuals import chi2_per_edge
from masat.robust.closures import REACH, Closures, connected
from masat.robust.prediction import agreement, predict, predict_by_odometry

# Likelihood ratios, in logarithms: that of a closure which others support, and how much more one
# alone needs than the number of such closures, while the map grows and in the end.
MIN_RATIO, ODDS_ALONE, _FINAL_ODDS = 3.0, 3.0, 1.5
_TOLERANCE, _ITERATIONS, _ROUGH_ITERATIONS = 1e-5, 30, 8
_MAX_ROUNDS, _MAX_STALLS, _MAX_REFINEMENTS = 100, 8, 5
# Nodes from an end of a new closure within which predictions are made again at once.
NEAR = 5 * REACH
# A group of new closures is dropped if more than this fraction of it has to be.
_MAX_LOST = 0.3
# Closures with which a map begins fit together if no more than this fraction has to be dropped.
_MAX_MISFIT = 0.02
# So small a fraction of the kept closures is believed in one round.
_FEW = 0.35
# Fraction of new closures below which the map predicts what it did before.
_NEXT_TO_NONE = 0.005
# Squared distances beyond this many gates are not looked at again until nothing else is left.
_FAR_OFF = 100.0
# Gates within which a group has to be for its members to be predicted one by one.
_MAX_DIFFERENCE = 4.0


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
        count = len(closures)
        trusted = closures.graph.without_edges(~closures.trusted)
        self.map: PoseGraph = guess_of(trusted, "chordal")
        self.kept: Flags = np.zeros(count, np.bool_)
        self.banned: Flags = np.zeros(count, np.bool_)
        self.refused: Flags = np.zeros(count, np.bool_)
        # Closures whose prediction is that of another one of their group.
        self._borrowed: Flags = np.zeros(count, np.bool_)
        self.equations: _core.NormalEquations = normal_equations(self.map, closures.threads)
        self.distance: Floats = np.full(count, np.inf)
        self.log_ratio: Floats = np.full(count, -np.inf)
        self._set_map(self.kept)
        self.distance, self.log_ratio = predict_by_odometry(closures, self.map, np.arange(count))
        pairs = closures.pairs
        agree = pairs[agreement(closures, self.poses, pairs) < GATE[closures.graph.dof]]
        self.supported: Flags = np.zeros(count, np.bool_)
        self.supported[agree.ravel()] = True
        # Closures that agree, by way of others: they are likely all true or all false.
        self.runs: Indices = connected(count, agree)
        self.representative = representatives(count, agree)

    @property
    def poses(self) -> Floats:
        """The poses of the map, (n, 3) or (n, 7)."""
        assert self.map.poses is not None
        return self.map.poses

    @property
    def chi2(self) -> Floats:
        """chi2 of each edge of the whole graph at the poses of the map, (m,)."""
        return chi2_per_edge(self._closures.graph, self.poses)

    def begin_with(self, believed: Ids) -> None:
        """Believe closures that another map kept, unless they do not fit together.

        The others are predicted from the map that they make.
        """
        if len(believed) == 0:
            return
        before = self.copy()
        self.believe(believed)
        if int(self.kept.sum()) < (1 - _MAX_MISFIT) * len(believed):
            self.__dict__.update(before.__dict__)
        else:
            self._predict_runs(~self.kept)

    def grow(self, *, everywhere: bool = True, thorough: bool = False) -> None:
        """Believe closures until the map predicts no other.

        Parameters
        ----------
        everywhere : bool
            Whether to predict all closures again where nothing is likely near the last ones.
        thorough : bool
            Whether to predict each closure by itself in the end, since the one that represents
            it may be false.
        """
        fresh = not self.kept.any()
        predicted, stalls = np.zeros_like(self.kept), 0
        for _ in range(_MAX_ROUNDS):
            if self._progress.over:
                return
            likely = self._likely()
            if len(likely):
                # The last few may be believed at once.
                few = len(likely) <= _FEW * self.kept.sum()
                new = likely if few else likely[: (len(likely) + 1) // 2]
                new = self._confirmed(new)
                if len(new) == 0:
                    continue
                self._progress.tell(f"believing {int(self.kept.sum()) + len(new)} loop closures")
                self.believe(new)
                self._predict_runs(self._near(new) & self.supported)
                fresh = False
            elif not everywhere:
                break
            elif fresh or stalls == _MAX_STALLS or self._is_like(predicted):
                if not thorough:
                    break
                thorough = False
                self._predict(np.flatnonzero(~self.kept & self._borrowed & ~self._far_off))
            else:
                stalls += 1
                # The map has changed, so that what did not fit may do so now.
                predicted = self.kept.copy()
                self.refused = np.zeros_like(self.refused)
                self._predict_runs(~self.kept)
                self._predict(np.flatnonzero(~self.kept & self._borrowed & self._near_gate))
                fresh = True
        self._refine()
        self._predict_dropped()

    def believe(self, new: Ids, *, rough: bool = False) -> None:
        """Add closures to the map, and drop those that are then far beyond their information.

        A rough map is enough to see whether closures fit.
        """
        iterations = _ROUGH_ITERATIONS if rough else _ITERATIONS
        before = self.kept, self.map, self.equations, self.refused
        try:
            kept = self.kept.copy()
            kept[new] = True
            self._set_map(kept, iterations)
            far = self.kept & (self.chi2[self._closures.edges] > FAR_GATE[self._closures.graph.dof])
            if far.any():
                # A group that agrees is as a rule true or false as a whole.
                lost = np.bincount(self.representative[far], minlength=len(far))
                of = np.bincount(self.representative[self.kept], minlength=len(far))
                split = np.zeros(len(far), np.bool_)
                split[new] = (lost > _MAX_LOST * of)[self.representative[new]]
                self.refused = self.refused | far | split
                self._set_map(self.kept & ~(far | split), iterations)
        except BaseException:
            # What was not checked is not believed.
            self.kept, self.map, self.equations, self.refused = before
            raise

    def disbelieve(self, old: Ids) -> None:
        """Take closures out of the map for good."""
        kept = self.kept.copy()
        kept[old] = False
        self.banned[old] = True
        self._set_map(kept)

    def count_likely(self) -> int:
        """Return how many of the closures that agree with others the map would now believe."""
        if self._closures.few:
            self._predict(np.flatnonzero(self.candidates))
        else:
            self._predict_runs(self.candidates)
        return len(self._likely())

    @property
    def candidates(self) -> Flags:
        """Closures that others support and that the map may come to believe, (c,)."""
        return ~self.kept & ~self.banned & self.supported & ~self._far_off

    def finish(self) -> None:
        """Believe what is likely now that no other closure can follow."""
        likely = self._confirmed(self._likely(_FINAL_ODDS), _FINAL_ODDS)
        if len(likely):
            self.believe(likely)
            self._refine()
            self._predict_dropped()

    @property
    def _far_off(self) -> Flags:
        """Closures so far from their prediction that they are looked at last, (c,)."""
        return self.distance > _FAR_OFF * GATE[self._closures.graph.dof]

    @property
    def _near_gate(self) -> Flags:
        """Closures that may fit although another one of their group does not quite, (c,)."""
        return self.distance < _MAX_DIFFERENCE * GATE[self._closures.graph.dof]

    def copy(self) -> Growth:
        """Return a growth that can be tried without changing this one."""
        other = object.__new__(Growth)
        other.__dict__.update(self.__dict__)
        for name in ("kept", "banned", "refused", "_borrowed", "distance", "log_ratio"):
            setattr(other, name, getattr(self, name).copy())
        return other

    def _likely(self, odds: float = ODDS_ALONE) -> Ids:
        """Return the closures to believe next, the most likely first."""
        free = ~(self.kept | self.banned | self.refused)
        # The more closures there are, the more likely a false one fits by chance.
        alone = np.log(max(int(np.count_nonzero(~self.kept & ~self.supported)), 1)) + odds
        needed = np.where(self.supported, MIN_RATIO, alone)
        within = self.distance < GATE[self._closures.graph.dof]
        likely = np.flatnonzero(free & within & (self.log_ratio > needed))
        return likely[np.argsort(-self.log_ratio[likely], kind="stable")]

    def _is_like(self, kept: Flags) -> bool:
        """Return whether next to no closure is kept that was not kept before."""
        new = int(np.count_nonzero(self.kept & ~kept))
        limit = 0.0 if self._closures.few else _NEXT_TO_NONE
        return bool(new <= limit * np.count_nonzero(self.kept))

    def _confirmed(self, likely: Ids, odds: float = ODDS_ALONE) -> Ids:
        """Return those that are likely also by a prediction of their own."""
        borrowed = likely[self._borrowed[likely]]
        if len(borrowed) == 0:
            return likely
        self._predict(borrowed)
        return likely[np.isin(likely, self._likely(odds))]

    def _near(self, new: Ids) -> Flags:
        """Return the closures near new ones that are not far off, (c,)."""
        n = len(self._closures.graph)
        ends = self._closures.ends[new].ravel()
        begun = np.bincount(np.maximum(ends - NEAR, 0), minlength=n + 1)
        ended = np.bincount(np.minimum(ends + NEAR + 1, n), minlength=n + 1)
        touched = np.cumsum(begun - ended)[:n] > 0
        here = np.any(touched[self._closures.ends], axis=1)
        near: Flags = ~self.kept & here & ~self._far_off
        return near

    def _predict(self, chosen: Ids) -> None:
        if len(chosen):
            found = predict(self._closures, self.map, chosen, self.equations)
            self.distance[chosen], self.log_ratio[chosen] = found
            self._borrowed[chosen] = False

    def _predict_runs(self, which: Flags) -> None:
        """Predict one closure for each few that agree with it."""
        members = np.flatnonzero(which)
        chosen = self.representative[members]
        # Where that one was judged already, each is predicted by itself.
        chosen = np.where(which[chosen], chosen, members)
        self._predict(np.unique(chosen))
        self.distance[members] = self.distance[chosen]
        self.log_ratio[members] = self.log_ratio[chosen]
        self._borrowed[members] = members != chosen

    def _refine(self) -> None:
        """Keep exactly the closures within the gate of the map that they make."""
        dof = self._closures.graph.dof
        for _ in range(_MAX_REFINEMENTS):
            within = self.kept & (self.chi2[self._closures.edges] < GATE[dof])
            if (within == self.kept).all() or self._progress.over:
                return
            self._set_map(within)

    def _predict_dropped(self) -> None:
        """Predict the closures that were kept when they were predicted last."""
        self._predict(np.flatnonzero(~self.kept & np.isinf(self.distance)))

    def _set_map(self, kept: Flags, iterations: int = _ITERATIONS) -> None:
        """Optimize the trusted edges and these closures, and keep exactly them."""
        graph = self._closures.graph_with(kept, self.poses)
        equations = normal_equations(graph, self._closures.threads)
        result = optimize(
            graph,
            "dogleg",
            max_iterations=iterations,
            relative_tolerance=_TOLERANCE,
            equations=equations,
        )
        # What is dropped was predicted by a map without it, long ago.
        dropped = self.kept & ~kept
        self.distance[dropped], self.log_ratio[dropped] = np.inf, -np.inf
        self.kept, self.map, self.equations = kept, result.graph, equations


def representatives(count: int, agree: Ids) -> Ids:
    """Return for each closure the one that agrees with most others, among it and those agreeing."""
    degree = np.bincount(agree.ravel(), minlength=count)
    rank = degree * (count + 1) + np.arange(count, 0, -1)
    best = rank.copy()
    i, j = agree.T
    np.maximum.at(best, i, rank[j])
    np.maximum.at(best, j, rank[i])
    representatives: Ids = count - best % (count + 1)
    return representatives
