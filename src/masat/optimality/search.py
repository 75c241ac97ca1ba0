"""From a minimum of chi2 to lower ones."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from masat import lie
from masat.arrays import Flags, Floats
from masat.errors import InitializationError, OptimizationError
from masat.graph import PoseGraph
from masat.optimality import cycles
from masat.optimality.lifting import lift
from masat.optimality.relaxation import Relaxation
from masat.optimality.subgraphs import Region, Surroundings
from masat.optimizers import Iteration, Result, optimize
from masat.optimizers.translations import solve_translations
from masat.residuals import chi2_per_edge

# chi2 this much lower, relatively, is another minimum; near one its changes are below the second.
LOWER, NEAR = 1e-7, 1e-8
# Edges from a place where the certificate fails, from a weak edge, and from the nodes that a loop
# turns: what lies no farther is lifted.
_REACH, _WEAK_REACH, _LOOP_REACH = 6, 3, 3
# In units of chi2: with no more than this above the minimum, all nodes together are asked.
_NEARLY = 5.0
# A trial ends where so many more steps like the last would not bring it near.
_HOPE = 40
# Radians: a loop whose error has changed by less need not be tried again; and no coordinate of a
# node that has not moved has changed by more, meters too.
_STRAIGHT = 0.01
# How many loops are tried at the most: the first divided by the nodes of the graph, but not fewer
# than the second.
_WORK, _LOOPS = 1_000_000, 10
_ROUNDS = 20
# Iterations of Gauss-Newton to the very end, and of what is surer and slower.
_LAST, _VERY_LAST = 4, 100

Trial = Callable[[Region], Result]


def lower_minimum(graph: PoseGraph, *, seed: int = 0) -> Result:
    """Search for a lower minimum around the places that leave doubt about one.

    Nodes are lifted (`masat.optimality.lifting`), the rest held still: first those around the places where
    the certificate fails and around weak edges, each connected part for itself, as long as that
    lowers chi2; then those of each weak loop (`masat.optimality.cycles`), which are also turned once more,
    either way. What lowers chi2 stands at once; after a round that did, all begins anew.

    Parameters
    ----------
    graph : PoseGraph
        A graph with poses near a minimum.
    seed : int
        Of the noise that opens a higher rank.

    Returns
    -------
    Result
        Of the optimizer, at the lowest minimum met.

    Raises
    ------
    OptimizationError
        If the graph has no poses.
    """
    search = _Search(graph, seed)
    for _ in range(_ROUNDS):
        if not (search.at_weak_places() or search.at_weak_loops()):
            break
        search.settle()
    found = graph.with_poses(search.poses)
    end = optimize(found, "gauss_newton", relative_tolerance=1e-12, max_iterations=_LAST)
    if end.converged and end.chi2 <= search.chi2:
        return end
    # Gauss-Newton leaves even the surroundings of some minima, but not the minimum itself.
    return optimize(found, "dogleg", relative_tolerance=0.0, max_iterations=_VERY_LAST)


class _Search:
    """The lowest minimum met so far."""

    def __init__(self, graph: PoseGraph, seed: int) -> None:
        if graph.poses is None:
            raise OptimizationError("the graph has no poses: there is no minimum to begin at")
        self.poses = graph.poses
        self._graph = graph
        self._seed = seed
        settled = self.settle()
        # Of chi2: less than one where the information promises less than it keeps.
        self._unit = min(1.0, settled.reduced_chi2 or 1.0)
        self._relaxed = Relaxation(graph)
        self._loops = cycles.WeakLoops(graph, self._unit)
        self._surroundings = Surroundings(graph)
        self._refused: dict[int, float] = {}
        self._left = max(_LOOPS, _WORK // len(graph.ids))
        anchors = graph.index(graph.gauge)
        labels = graph.components
        held = np.bincount(labels[anchors], minlength=int(labels.max()) + 1)
        # What holds only the gauge may turn with the rest, and is put back afterwards.
        self._gauge = anchors[held[labels[anchors]] == 1]
        self._held = anchors[held[labels[anchors]] > 1]

    def settle(self) -> Result:
        """Go to the minimum."""
        result = _minimum(self._graph, self.poses)
        self.poses, self.chi2 = _poses(result), result.chi2
        return result

    def at_weak_places(self) -> bool:
        """Lift what lies around the weak places; return whether that lowered chi2."""
        around = self._surroundings.around
        places = np.zeros(len(self.poses), np.bool_)
        places[self._relaxed.weak_places(self.poses)] = True
        edges = np.zeros_like(places)
        edges[self._graph.edge_indices[self._loops.weak_edges(self.poses)]] = True
        nodes = around(places, _REACH) | around(edges, _WEAK_REACH)
        nodes[self._graph.index(self._graph.gauge)] = False
        return sum(self._try(part, self._lift) for part in self._surroundings.parts(nodes)) > 0

    def at_weak_loops(self) -> bool:
        """Lift the weak loops, and turn them once more; return whether that lowered chi2."""
        around = self._surroundings.around
        lowered = most_lifted = False
        for loop in self._loops.promising(self.poses):
            if abs(loop.error - self._refused.get(loop.edge, np.inf)) < _STRAIGHT:
                continue
            if self._left == 0:
                break
            self._left -= 1
            turns = self._relative(loop)
            nodes = cycles.apart(turns)
            trials: list[tuple[Flags, Trial]] = [
                (around(nodes), partial(self._turn, axis, turns))
                for axis in (loop.axis, -loop.axis)
            ]
            most = bool(2 * np.count_nonzero(nodes) > len(nodes))
            # Two lifts of most nodes are as good as the same.
            if not (most and most_lifted):
                trials.insert(0, (around(nodes, _LOOP_REACH), self._lift))
            most_lifted |= most
            lower = any(self._try(where, trial) for where, trial in trials)
            lowered |= lower
            if not lower:
                self._refused[loop.edge] = loop.error
        return lowered

    def _relative(self, loop: cycles.Loop) -> Floats:
        """Return the turns of a loop; where it is the gauge alone that holds, as few as can be."""
        labels = self._graph.components
        label = labels[self._graph.edge_indices[loop.edge, 0]]
        if label in labels[self._gauge]:
            return cycles.stilled(loop.turns, labels == label)
        return loop.turns

    def _lift(self, region: Region) -> Result:
        start = region.graph.with_poses(lift(region.graph, seed=self._seed))
        # What is rounded lies between minima: one method may end in a lower one than the other.
        return min(
            (
                optimize(start, method, relative_tolerance=NEAR, max_iterations=50)
                for method in ("dogleg", "levenberg_marquardt")
            ),
            key=lambda result: result.chi2,
        )

    def _turn(self, axis: Floats, turns: Floats, region: Region) -> Result:
        part, inside = region
        assert part.poses is not None
        angles = np.where(inside, turns[part.ids], 0.0)
        start = cycles.turned(part.poses, axis, angles)
        nearly = _NEARLY * self._unit
        return optimize(
            part.with_poses(solve_translations(part, start)),
            "dogleg",
            max_iterations=30,
            absolute_tolerance=nearly / 500,
            report=_Hope(float(chi2_per_edge(part).sum()) + nearly),
        )

    def _try(self, nodes: Flags, trial: Trial) -> bool:
        """Keep what a trial makes of some nodes if it lowers chi2; return whether."""
        graph, before = self._graph, self.poses
        nodes = nodes.copy()
        nodes[self._held] = False
        if not nodes.any():
            return False
        region = self._surroundings.region(before, nodes)
        try:
            result = trial(region)
        except (InitializationError, OptimizationError):
            # A part may be too badly conditioned for what the whole can bear.
            return False
        places = region.graph.ids[region.inside]
        poses = before.copy()
        poses[places] = _poses(result)[region.inside]
        if np.abs(lie.local(before[places], poses[places])).max() < _STRAIGHT:
            return False
        self._put_back(poses, nodes)
        chi2 = self.chi2 + result.chi2 - float(chi2_per_edge(region.graph).sum())
        lower = self.chi2 * (1 - LOWER)
        if lower <= chi2 < self.chi2 + _NEARLY * self._unit:
            # Nearly as low: with all nodes free it may be lower.
            free = _minimum(graph, poses, _Hope(lower, chi2))
            poses, chi2 = _poses(free), free.chi2
        if chi2 < lower:
            self.poses, self.chi2 = poses, chi2
            return True
        return False

    def _put_back(self, poses: Floats, moved: Flags) -> None:
        """Move the components of anchors that a trial has moved so that these hold still."""
        labels = self._graph.components
        for k in self._gauge[moved[self._gauge]]:
            own = labels == labels[k]
            back = lie.compose(self.poses[k], lie.inverse(poses[k]))
            poses[own] = lie.compose(back, poses[own])
            poses[k] = self.poses[k]


class _Hope:
    """Stops an optimizer where many more steps like the last would not bring chi2 below a mark."""

    def __init__(self, mark: float, chi2: float = np.inf) -> None:
        self._mark, self._last = mark, chi2

    def __call__(self, step: Iteration) -> bool:
        """Return whether to stop after an iteration."""
        gained, self._last = self._last - step.chi2, step.chi2
        return step.chi2 - self._mark > _HOPE * gained


def _minimum(graph: PoseGraph, poses: Floats, report: _Hope | None = None) -> Result:
    """Return the minimum that an optimizer finds from some poses."""
    return optimize(
        graph.with_poses(poses),
        "dogleg",
        relative_tolerance=NEAR,
        max_iterations=50,
        report=report,
    )


def _poses(result: Result) -> Floats:
    assert result.graph.poses is not None
    return result.graph.poses
