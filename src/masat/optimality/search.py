"""From a minimum of chi2 to lower ones."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property, partial
from itertools import islice, pairwise

import numpy as np

from masat import _core
from masat.arrays import Flags, Floats, Indices
from masat.graph import PoseGraph
from masat.optimality.bounds import doubtful_nodes
from masat.optimality.cycles import (
    LONG,
    AmbiguousCycles,
    Cycle,
    cut_edges,
    relative_to_mean,
    rotating_nodes,
)
from masat.optimality.relaxation import Relaxation, lifted_operations
from masat.optimality.splices import OtherMinimum
from masat.optimality.strings import Strings
from masat.optimality.subgraphs import Subgraph, connected_parts, neighborhood
from masat.optimality.trials import (
    LOWER,
    NEARLY,
    LowestMinimum,
    Trial,
    lifted,
    shifted_along,
    spliced_in,
)
from masat.optimizers import Result, optimize
from masat.optimizers.equations import normal_equations
from masat.progress import Progress
from masat.residuals import chi2_per_edge

# Minima whose chi2 differs by a smaller fraction are taken to be the same.
_SAME_MINIMUM = 1e-6
# Edges from a node where the certificate fails, and from an edge of an ambiguous cycle, within
# which nodes are lifted.
_NODE_REACH, _EDGE_REACH = 6, 3
# Nodes around a doubtful one that are lifted together: some milliseconds.
_CHEAP_PART = 250
# Those within which they are lifted at last, around all such nodes and around those where it fails
# by much, one after the other; and the fractions of all nodes that a part may be then.
_WIDER_REACH, _REFUTED_REACHES = 12, (12, 24, 48)
_LITTLE, _MUCH = 0.2, 0.5
# A residual that changed by a smaller fraction of itself is the same as before, and so are edges
# whose chi2 changed by less in all than so many units (`LowestMinimum.unit`).
_SAME_RESIDUAL, _SAME_CHI2 = 0.02, 0.5
# Edges of a cycle from which on its residuals depend on the positions as much as on the rotations:
# a shift either way may pay. Where one costs less than so many units of chi2, half a turn may lead
# to another bend with the same winding number.
_SOFT, _BENDING = 10, 10.0
# Cycles tried at the most: the first divided by the number of nodes, but at least the second.
_CYCLE_WORK, _MIN_CYCLES = 1_000_000, 10
# Edges from the ends of a string within which nodes are free; strings that may fail one after the
# other; and how near to a minimum the next strings are sought.
_STRING_REACH, _MAX_FAILURES, _STRING_TOLERANCE = 6, 40, 1e-5
# Strings after which chi2 that is nearly as low is optimized no further.
_FIRST = 10
_MAX_ROUNDS = 20
# How near to a minimum nodes are lifted, which mostly leads to another one.
_FIRST_TOLERANCE = 1e-5
# Operations of a factorization up to which all nodes are lifted at once: a second on one core.
_MAX_LIFTED_OPERATIONS = 1e9
# Iterations of Gauss-Newton to the exact minimum, and of the safer and slower dogleg.
_FINAL_ITERATIONS, _FINAL_DOGLEG_ITERATIONS = 4, 100


def lower_minimum(
    graph: PoseGraph,
    *,
    seed: int = 0,
    progress: Progress | None = None,
    equations: _core.NormalEquations | None = None,
    others: Sequence[Floats] = (),
) -> Result:
    """Search for a lower minimum around the parts of the graph where this one is doubtful.

    Nodes are lifted to a higher rank while the rest is fixed: those around the nodes where the
    certificate fails and around the edges of ambiguous cycles, each connected part by itself, as
    long as that lowers chi2. If chi2 is certified then, the search ends. If not, the nodes around
    each doubtful node are lifted (`bounds.doubtful_nodes`), in 2D, and each ambiguous
    cycle (`cycles.py`) where the certificate fails is shifted by 2 pi against its residual, a soft
    one the other way and by half a turn, too; in 3D the nodes around it are also lifted. At last
    wider parts are lifted. Each trial that lowers chi2 is kept at once; after a round with such a
    trial another round begins.

    Parameters
    ----------
    graph : PoseGraph
        A graph with poses near a minimum.
    seed : int
        Seed of the random noise that is added when a rank is raised.
    progress : Progress, optional
        What reports the stages and limits the time.
    equations : NormalEquations, optional
        Those of the graph, to be used again.
    others : sequence of ndarray, (n, 3) or (n, 7)
        Poses at other minima, whose better parts are taken (`splices.py`) before anything is
        lifted or shifted.

    Returns
    -------
    Result
        That of the optimizer at the lowest minimum found.

    Raises
    ------
    OptimizationError
        If the graph has no poses.
    """
    progress = progress or Progress()
    equations = normal_equations(graph) if equations is None else equations
    search = _Search(graph, seed, progress, equations)
    try:
        if others:
            search.combine(others)
        for _ in range(_MAX_ROUNDS):
            lower = search.at_differences(search.others)
            lower = lower or (graph.dimension == 3 and search.at_strings())
            lower = lower or search.at_uncertified_nodes()
            if not lower and not progress.over:
                search.lowest.converge()
                doubtful = search.doubtful_nodes()
                if len(doubtful) == 0:
                    break
                # In 3D nearly all nodes are doubtful where noise is high.
                lower = graph.dimension == 2 and search.at_doubtful_nodes(doubtful)
                lower = lower or search.at_cycles(doubtful) or search.at_wider_parts()
            if progress.over or not lower:
                break
            search.lowest.converge(_FIRST_TOLERANCE)
    except KeyboardInterrupt:
        progress.interrupt()
    return exact_minimum(graph.with_poses(search.poses), equations, progress)


def exact_minimum(near: PoseGraph, equations: _core.NormalEquations, progress: Progress) -> Result:
    """Return the minimum near which the poses of a graph are."""
    finish = partial(optimize, near, equations=equations, progress=progress)
    end = finish("gauss_newton", relative_tolerance=1e-12, max_iterations=_FINAL_ITERATIONS)
    if progress.over or (end.converged and end.chi2 <= end.initial_chi2):
        return end
    # Gauss-Newton leaves the surroundings of some minima, but not the minimum itself.
    return finish("dogleg", relative_tolerance=0.0, max_iterations=_FINAL_DOGLEG_ITERATIONS)


class _Search:
    """A search from a minimum to lower ones."""

    def __init__(
        self,
        graph: PoseGraph,
        seed: int,
        progress: Progress,
        equations: _core.NormalEquations,
    ) -> None:
        self.lowest = LowestMinimum(graph, progress, equations, _FIRST_TOLERANCE)
        # Poses at other minima, whose parts are tried after each round.
        self.others: Sequence[OtherMinimum] = ()
        self._graph = graph
        self._seed = seed
        self._progress = progress
        self._relaxation = Relaxation(graph)
        self._cycles = AmbiguousCycles(graph)
        # The nodes that were lifted, (n,), and chi2 of all edges, (m,), when they were.
        self._lifts_in_vain: list[tuple[Flags, Floats]] = []
        self._refused: dict[tuple[tuple[int, float], ...], Floats] = {}
        self._cycles_left = max(_MIN_CYCLES, _CYCLE_WORK // len(graph.ids))

    @property
    def poses(self) -> Floats:
        """The poses of the lowest minimum found so far."""
        return self.lowest.poses

    @property
    def chi2(self) -> float:
        """Their chi2."""
        return self.lowest.chi2

    @cached_property
    def _strings(self) -> Strings:
        return Strings(self._graph)

    def doubtful_nodes(self) -> Indices:
        """Return indices of nodes of which some move wherever chi2 is lower, see `bounds`."""
        return doubtful_nodes(self._graph.with_poses(self.poses))

    def at_uncertified_nodes(self) -> bool:
        """Lift what is around uncertified nodes; return whether that lowered chi2."""
        graph = self._graph
        nodes = np.zeros(len(self.poses), np.bool_)
        nodes[self._relaxation.uncertified_nodes(self.poses)] = True
        ends = np.zeros_like(nodes)
        ends[graph.edge_indices[self._cycles.edges(self.poses)]] = True
        around = neighborhood(graph, nodes, _NODE_REACH) | neighborhood(graph, ends, _EDGE_REACH)
        around[graph.index(graph.gauge)] = False
        parts = list(connected_parts(graph, around))
        self._progress.tell(f"searching in {len(parts)} uncertified parts", self.chi2)
        return sum(self._lift_if_new(part) for part in parts) > 0

    def at_doubtful_nodes(self, doubtful: Indices) -> bool:
        """Lift what is around each doubtful node; return whether that lowered chi2.

        As much as is cheap: a long chain of nodes may have to bend otherwise as a whole.
        """
        done = np.zeros(len(self.poses), np.bool_)
        lower = False
        for node in doubtful:
            if done[node] or self._progress.over:
                continue
            self._progress.tell("searching around a doubtful node", self.chi2)
            around = np.zeros_like(done)
            around[node] = True
            wider = neighborhood(self._graph, around)
            while np.count_nonzero(around) < np.count_nonzero(wider) <= _CHEAP_PART:
                around, wider = wider, neighborhood(self._graph, wider)
            done |= around
            around[self._graph.index(self._graph.gauge)] = False
            lower |= self._lift_if_new(around)
        return lower

    def at_cycles(self, doubtful: Indices) -> bool:
        """Shift the ambiguous cycles, most by 2 pi; return whether that lowered chi2.

        Until chi2 is lower, only those around doubtful nodes, of which some move wherever it is.
        """
        cycles = list(islice(self._cycles.at(self.poses), self._cycles_left))
        long = [cycle for cycle in cycles if len(cycle.edges) >= LONG]
        soft = [cycle for cycle in cycles if len(cycle.edges) >= _SOFT]
        moves = [[(cycle, 0.0)] for cycle in long]
        moves += [[(cycle, -1.0)] for cycle in cycles]
        moves += [[(cycle, 1.0)] for cycle in soft]
        bending = [cycle for cycle in soft if cycle.stiffness < _BENDING * self.lowest.unit]
        moves += [[(cycle, turns)] for cycle in bending for turns in (-0.5, 0.5)]
        for one, other in self._cycles.pairs(cycles):
            moves.append([(one, -1.0), (other, -1.0)])
            if len(one.edges) >= LONG and len(other.edges) >= LONG:
                moves += [[(one, -1.0), (other, 1.0)], [(one, 1.0), (other, -1.0)]]
        changed: set[int] = set()
        for shifts in moves:
            edges = {cycle.edge for cycle, _ in shifts}
            key = tuple((cycle.edge, turns) for cycle, turns in shifts)
            signed = np.concatenate([np.atleast_1d(c.residual * c.axis) for c, _ in shifts])
            refused = self._refused.get(key)
            same = refused is not None and np.allclose(signed, refused, rtol=_SAME_RESIDUAL)
            if same or edges & changed:
                continue
            if self._cycles_left == 0 or self._progress.over:
                break
            nodes = np.zeros(len(self.poses), np.bool_)
            for cycle, _ in shifts:
                nodes |= rotating_nodes(self._relative(cycle))
                if len(cycle.edges) >= LONG:
                    nodes |= cycle.nodes
            where = neighborhood(self._graph, nodes)
            if not changed and not self._may_lower(where, doubtful):
                continue
            self._cycles_left -= 1
            self._progress.tell("searching around an ambiguous cycle", self.chi2)
            cuts = [None, *(cut_edges(shifts[0][0]) if shifts[0][1] == 0 else ())]
            own = np.array([cycle.edge for cycle, _ in shifts])
            by = np.array([2 * np.pi * turns * cycle.axis for cycle, turns in shifts])
            trials: list[Trial] = [self._shift(own, by, cut) for cut in cuts]
            if any(self.lowest.attempt(where, trial) for trial in trials) or (
                self._graph.dimension == 3 and self._lift_if_new(where)
            ):
                changed |= edges
            else:
                self._refused[key] = signed
        return len(changed) > 0

    def _may_lower(self, where: Flags, doubtful: Indices) -> bool:
        """Whether chi2 may be lower where only some nodes, (n,), move.

        The doubtful nodes hold for a gauge that does not move, and where most nodes are free all
        are.
        """
        moves = bool(where[doubtful].any() or where[self.lowest.movable].any())
        return moves or bool(np.count_nonzero(where) > len(where) / 2)

    def _lift_if_new(self, nodes: Flags) -> bool:
        """Lift nodes, (n,), where that may help; return whether it lowered chi2.

        It is done unless they were all free in a lift in vain and chi2 around them is as then.
        Where most nodes are to be lifted, all are, if memory allows it.
        """
        widen = self._lifts_cheaply
        if widen and np.count_nonzero(nodes) > len(nodes) / 2:
            nodes = np.ones(len(nodes), np.bool_)
            nodes[self._graph.index(self._graph.gauge)] = False
        chi2 = chi2_per_edge(self._graph, self.poses)
        own = self._graph.topology.incident_edges(nodes)
        for there, before in self._lifts_in_vain:
            if (nodes & ~there).any():
                continue
            if np.abs(chi2[own] - before[own]).sum() <= _SAME_CHI2 * self.lowest.unit:
                return False
        if self.lowest.attempt(nodes, self._lift, widen=widen):
            return True
        self._lifts_in_vain.append((nodes, chi2))
        return False

    def at_strings(self) -> bool:
        """Shift strings of edges; return whether that lowered chi2."""
        first = self.chi2
        refused: set[tuple[int, ...]] = set()
        failures = 0
        while not self._progress.over and failures < _MAX_FAILURES:
            for string in self._strings.at(self.poses):
                key = tuple(sorted(string.edges.tolist()))
                if key in refused:
                    continue
                self._progress.tell("searching along a string of edges", self.chi2)
                ends = np.zeros(len(self.poses), np.bool_)
                ends[self._graph.edge_indices[string.edges]] = True
                where = neighborhood(self._graph, ends, _STRING_REACH)
                trial = self._shift(string.edges, string.vectors)
                if self.lowest.attempt(where, trial, NEARLY if failures < _FIRST else 0.0):
                    self.lowest.converge(_STRING_TOLERANCE)
                    failures = 0
                    break
                refused.add(key)
                failures += 1
                if failures == _MAX_FAILURES:
                    break
            else:
                break
        return self.chi2 < first * (1 - LOWER)

    def combine(self, others: Sequence[Floats]) -> None:
        """Take the better parts of this minimum and others.

        Each minimum in turn takes the parts of all others that lower its chi2, and then the lowest
        those of what the others have become. That all end at the same minimum does not show
        that none is lower.
        """
        minima = [self.poses, *others]
        ends = [(self.chi2, self.poses)]
        try:
            for poses in minima:
                self.lowest.poses = poses
                self.lowest.converge()
                self.at_differences([OtherMinimum(o) for o in minima if o is not poses])
                self.lowest.converge()
                ends.append((self.chi2, self.poses))
        finally:
            ends.sort(key=lambda end: end[0])
            self.lowest.chi2, self.lowest.poses = ends[0]
        self.others = [
            OtherMinimum(poses)
            for (lower, _), (chi2, poses) in pairwise(ends)
            if chi2 > lower * (1 + _SAME_MINIMUM)
        ]

    def at_differences(self, others: Sequence[OtherMinimum]) -> bool:
        """Take the parts of other minima that lower chi2; return whether there are any."""
        first = self.chi2
        for other in others:
            self._progress.tell("taking the better parts of two minima", self.chi2)
            for part in other.parts(self._graph, self.poses):
                trial = partial(spliced_in, other=other.poses)
                if not self.lowest.attempt(part, trial, widen=False):
                    other.refuse(part, self._graph, self.poses)
        return self.chi2 < first * (1 - LOWER)

    def at_wider_parts(self) -> bool:
        """Lift more of what is around uncertified nodes; return whether that lowered chi2.

        Parts of the graph that are each at their own minimum may be wrong together. Around refuted
        nodes ever more is lifted, around others as long as it is little.
        """
        uncertified = self._relaxation.uncertified_nodes(self.poses)
        if len(uncertified) == 0 or self._progress.over:
            return False
        refuted = self._relaxation.refuted_nodes(self.poses)
        stages = [(uncertified, _WIDER_REACH, _LITTLE)]
        stages += [(refuted, reach, _MUCH) for reach in _REFUTED_REACHES]
        for centers, reach, most in stages:
            nodes = np.zeros(len(self.poses), np.bool_)
            nodes[centers] = True
            around = neighborhood(self._graph, nodes, reach)
            around[self._graph.index(self._graph.gauge)] = False
            self._progress.tell("searching in wider parts", self.chi2)
            parts = [
                part
                for part in connected_parts(self._graph, around)
                if np.count_nonzero(part) <= most * len(part)
            ]
            if sum(self._lift_if_new(part) for part in parts) > 0:
                return True
        if len(refuted) == 0 or not self._lifts_cheaply:
            return False
        self._progress.tell("lifting all nodes", self.chi2)
        return self._lift_if_new(np.ones(len(self.poses), np.bool_))

    @property
    def _lifts_cheaply(self) -> bool:
        return lifted_operations(self._graph) <= _MAX_LIFTED_OPERATIONS

    def _relative(self, cycle: Cycle) -> Floats:
        """Return the rotations of a cycle's nodes; few of them if only the gauge is fixed."""
        labels = self._graph.components
        label = labels[self._graph.edge_indices[cycle.edge, 0]]
        if label in labels[self.lowest.movable]:
            return relative_to_mean(cycle.rotations, labels == label)
        return cycle.rotations

    def _lift(self, part: Subgraph, above: float) -> Result:
        return lifted(part, above, self._seed)

    def _shift(self, edges: Indices, vectors: Floats, cut: int | None = None) -> Trial:
        unit = self.lowest.unit
        return partial(shifted_along, shifted_edges=edges, vectors=vectors, cut=cut, unit=unit)
