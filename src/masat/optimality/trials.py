"""Trials of lower minima: nodes are moved elsewhere and optimized, and kept if chi2 is lower."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import TypeAlias

import numpy as np

from masat import _core, lie
from masat.arrays import Flags, Floats, Indices
from masat.errors import InitializationError, OptimizationError
from masat.graph import PoseGraph
from masat.optimality.cycles import shifted
from masat.optimality.relaxation import lift
from masat.optimality.splices import same_minimum, spliced
from masat.optimality.stopping import StopIfFar, StopIfHopeless
from masat.optimality.subgraphs import Subgraph, subgraph, whole, without_edges
from masat.optimizers import Result, optimize
from masat.optimizers.equations import Equations, normal_equations
from masat.optimizers.projection import ProjectedEquations
from masat.optimizers.translations import BestTranslations, solve_translations
from masat.progress import Progress

# chi2 that is lower by this fraction belongs to another minimum; near a minimum it changes by less
# than the second fraction from one iteration to the next.
LOWER, NEAR = 1e-7, 1e-8
# Units of chi2 above the minimum up to which a trial is optimized further with all nodes free; and
# the change of chi2, in units, at which it is near enough to its own minimum.
NEARLY, _ACCURACY = 5.0, 0.01
# Iterations of a trial after a shift, after a lift, and with all nodes free. A trial ends where the
# steps that are left, if they were all like the last one, would not lower chi2 enough.
_SHIFT_ITERATIONS, _LIFT_ITERATIONS, _FREE_ITERATIONS = 30, 50, 50
Trial: TypeAlias = Callable[[Subgraph, float], Result]
"""Optimizes a part from elsewhere, given how far above its chi2 the end may be to be of use."""


class LowestMinimum:
    """The lowest minimum found so far.

    Parameters
    ----------
    graph : PoseGraph
        A graph with poses near a minimum.
    progress : Progress
        What limits the time.
    equations : NormalEquations
        Those of the graph.
    tolerance : float
        How near to the minimum it goes at first, as a fraction of chi2.

    Attributes
    ----------
    poses : ndarray, (n, 3) or (n, 7)
        The poses there.
    chi2 : float
        Their chi2.
    unit : float
        What counts as one in chi2: less where the information promises less than it keeps.
    movable : ndarray of int
        Indices of the gauge nodes that are the only ones of their components.

    Raises
    ------
    OptimizationError
        If the graph has no poses.
    """

    def __init__(
        self,
        graph: PoseGraph,
        progress: Progress,
        equations: _core.NormalEquations,
        tolerance: float = NEAR,
    ) -> None:
        if graph.poses is None:
            raise OptimizationError("the graph has no poses: there is no minimum to begin at")
        self.poses = graph.poses
        self._graph, self._progress, self._equations = graph, progress, equations
        self.unit = min(1.0, self.converge(tolerance).reduced_chi2 or 1.0)
        gauge = graph.index(graph.gauge)
        labels = graph.components
        count = np.bincount(labels[gauge], minlength=int(labels.max()) + 1)
        # The only gauge node of a component may move with the rest, and is put back afterwards.
        self.movable = gauge[count[labels[gauge]] == 1]
        self._fixed = gauge[count[labels[gauge]] > 1]

    @cached_property
    def _translations(self) -> BestTranslations | None:
        try:
            return BestTranslations(self._graph)
        except InitializationError:
            return None

    def converge(self, tolerance: float = NEAR) -> Result:
        """Go to the minimum."""
        result = self._minimum(self.poses, tolerance=tolerance)
        self.poses, self.chi2 = result.poses, result.chi2
        return result

    def attempt(
        self, nodes: Flags, trial: Trial, nearly: float = NEARLY, *, widen: bool = True
    ) -> bool:
        """Keep what a trial makes of some nodes if it lowers chi2; return whether it does.

        Parameters
        ----------
        nodes : ndarray of bool, (n,)
            The nodes that are free.
        trial : callable
            Returns the result of an optimizer on the subgraph of these nodes.
        nearly : float
            How many units of chi2 above the minimum are optimized further with all nodes free, if
            they were not.
        widen : bool
            Whether all nodes are free where most are: the order of elimination of the whole graph
            is known, that of a large part is not.
        """
        graph, before = self._graph, self.poses
        nodes = nodes.copy()
        nodes[self._fixed] = False
        if self._progress.over or not nodes.any():
            return False
        widened = widen and np.count_nonzero(nodes) > len(nodes) / 2
        if widened:
            part, nearly = whole(graph, before, self._equations, self._translations), 0.0
        else:
            part = subgraph(graph, before, nodes)
        try:
            result = trial(part, nearly * self.unit)
        except (InitializationError, OptimizationError):
            # A part may be too badly conditioned for what the whole graph can bear.
            return False
        if not np.isfinite(result.chi2):
            return False
        indices = part.nodes[part.inside]
        poses = before.copy()
        poses[indices] = result.poses[part.inside]
        if same_minimum(before[indices], poses[indices]):
            return False
        if not widened:
            self._put_back(poses, nodes)
        chi2 = self.chi2 + result.chi2 - part.graph.chi2
        lower = self.chi2 * (1 - LOWER)
        if lower <= chi2 < self.chi2 + nearly * self.unit:
            # Nearly as low: with all nodes free it may become lower.
            free = self._minimum(poses, StopIfFar(lower, chi2))
            poses, chi2 = free.poses, free.chi2
        if chi2 < lower:
            self.poses, self.chi2 = poses, chi2
            return True
        return False

    def _put_back(self, poses: Floats, moved: Flags) -> None:
        """Move components whose gauge node a trial has moved so that it is where it was."""
        labels = self._graph.components
        for k in self.movable[moved[self.movable]]:
            own = labels == labels[k]
            back = lie.compose(self.poses[k], lie.inverse(poses[k]))
            poses[own] = lie.compose(back, poses[own])
            poses[k] = self.poses[k]

    def _minimum(
        self, poses: Floats, report: StopIfFar | None = None, tolerance: float = NEAR
    ) -> Result:
        """Return the minimum that an optimizer finds from some poses."""
        return optimize(
            self._graph.with_poses(poses),
            "dogleg",
            relative_tolerance=tolerance,
            max_iterations=_FREE_ITERATIONS,
            report=report,
            equations=self._equations,
            progress=self._progress,
        )


def lifted(part: Subgraph, above: float, seed: int) -> Result:
    """Lift the free nodes of a part to a higher rank, round them back and optimize them.

    Parameters
    ----------
    part : Subgraph
        The part.
    above : float
        As of `Trial`.
    seed : int
        Seed of the random noise that is added when a rank is raised.
    """
    initial = part.graph.with_poses(lift(part.graph, seed=seed))
    # Rounded poses lie between minima: in 3D one method may end in a lower one than the other.
    methods = ("dogleg",) if part.graph.dimension == 2 else ("dogleg", "levenberg_marquardt")
    return min(
        (
            _optimized(part, initial, above, _LIFT_ITERATIONS, method, relative_tolerance=NEAR)
            for method in methods
        ),
        key=lambda result: result.chi2,
    )


def spliced_in(part: Subgraph, above: float, other: Floats) -> Result:
    """Optimize a part from the poses, (n, 3) or (n, 7), of another minimum of the whole graph."""
    initial = part.graph.with_poses(spliced(part, other))
    return _optimized(part, initial, above, _SHIFT_ITERATIONS, relative_tolerance=NEAR)


def shifted_along(
    part: Subgraph,
    above: float,
    shifted_edges: Indices,
    vectors: Floats,
    cut: int | None,
    unit: float,
) -> Result:
    """Spread residuals and shifts anew, the positions first without an edge that is cut.

    Parameters
    ----------
    part : Subgraph
        The part.
    above : float
        As of `Trial`.
    shifted_edges : ndarray of int, (k,)
        Indices of the edges, in the whole graph, whose rotation residuals are shifted.
    vectors : ndarray, (k, 1) or (k, 3)
        By how much, as rotation vectors in radians.
    cut : int, optional
        Index of the edge that is cut.
    unit : float
        What counts as one in chi2.
    """
    graph = part.graph
    by = np.zeros((len(graph.edges), vectors.shape[1]))
    # An edge between nodes that are both fixed in the part is not in it.
    inside = np.isin(shifted_edges, part.edges)
    by[np.searchsorted(part.edges, shifted_edges[inside])] = vectors[inside]
    turned = shifted(graph, by)
    translations = part.translations or BestTranslations(graph)
    if cut is None:
        initial = translations(turned)
    else:
        initial = solve_translations(without_edges(graph, part.edges == cut), turned)
    equations = part.equations or normal_equations(graph)
    return _optimized(
        part,
        graph.with_poses(initial),
        above,
        _SHIFT_ITERATIONS,
        relative_tolerance=0.0,
        absolute_tolerance=_ACCURACY * unit,
        equations=ProjectedEquations(equations, translations),
    )


def _optimized(
    part: Subgraph,
    initial: PoseGraph,
    above: float,
    iterations: int,
    method: str = "dogleg",
    *,
    relative_tolerance: float = 1e-9,
    absolute_tolerance: float = 0.0,
    equations: Equations | None = None,
) -> Result:
    """Optimize a part from elsewhere, until it is back where it was or cannot become low enough."""
    assert part.graph.poses is not None
    # In 3D an optimizer that is back where it was may still lead to a minimum nearby.
    home = part.graph.poses if part.graph.dimension == 2 else None
    stop = StopIfHopeless(part.graph.chi2 + above, iterations, home)
    return optimize(
        initial,
        method,
        max_iterations=iterations,
        report=stop,
        report_poses=stop.look,
        equations=equations or part.equations,
        relative_tolerance=relative_tolerance,
        absolute_tolerance=absolute_tolerance,
    )
