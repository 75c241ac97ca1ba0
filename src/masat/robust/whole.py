"""The first hypothesis: all closures are true, but for a few outliers."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import numpy as np

from masat import _core
from masat.arrays import Flags, Floats, Ids
from masat.graph import PoseGraph
from masat.initializers import guess_of
from masat.initializers.chordal import chordal
from masat.neighbors import scale_of_best_tenth
from masat.optimizers import optimize
from masat.optimizers.equations import normal_equations
from masat.progress import Progress
from masat.quantiles import FAR_GATE, GATE
from masat.residuals import chi2_per_edge
from masat.robust.closures import Closures
from masat.robust.prediction import agreement, predict_by_odometry
from masat.robust.scales import Redundancy, Scales, redundancy

# Fraction of the closures that may be outliers of a map that is not in doubt.
_MAX_OUTLIERS = 0.02
_MAX_ROUNDS = 3
# Trusted edges that may be released, and how many times their gate they have to be off.
_MAX_RELEASED, _FAR = 5, 4.0
# Closures whose information is off by more, against that of the trusted edges, are judged with
# another one.
_MAX_RATIO, _EXACT = 6.0, 1e-6
# Factor by which information may be too large beyond what pairs of one place tell, and by which it
# may be off where nothing tells.
_MAX_EXCESS = 2.0
_UNKNOWN = 1.5
# Gates beyond which a closure is an outlier by what the others predict. Its own chi2 is smaller,
# since the optimization has spread the error.
_OUTLYING = 1.5
# Closures and pairs that are looked at before anything is optimized.
_SAMPLE, _MIN_PAIRS = 2000, 10
# The variance of a pair's cycle is estimated too large by about this factor.
_CAUTIOUS = 4.0
# Fraction of the pairs that may disagree, and gates that drift may take a true closure away.
_MAX_DISAGREEING, _MAX_DRIFT = 0.05, 10.0
_TOLERANCE, _ITERATIONS = 1e-4, 30


Guess: TypeAlias = Callable[[PoseGraph], PoseGraph]
"""From a graph to one with poses."""


class Fit(NamedTuple):
    """A map in which all closures fit but for a few outliers.

    Attributes
    ----------
    kept : ndarray of bool, (c,)
        The closures but for the outliers.
    graph : PoseGraph
        The map of the trusted edges and these.
    scales : Scales
        The scales of the information.
    released : ndarray of int64
        Indices of trusted edges that all others contradict: they are not in the map.
    """

    kept: Flags
    graph: PoseGraph
    scales: Scales
    released: Ids


def fit_of_all(
    closures: Closures,
    scale: float = 1.0,
    initialize: Guess = chordal,
    search: Guess | None = None,
    progress: Progress | None = None,
) -> Fit | None:
    """Return the map of all closures, if all but a few fit together; else None.

    Each edge is compared with what all others predict, with the information given; where it
    is too large by a common factor, with the factor that fits. False closures leave
    contradictions beyond that, even where the optimization has spread them. Where a trusted edge is
    contradicted most of all, and far, it is released.

    Parameters
    ----------
    closures : Closures
        The closures.
    scale : float
        A rough factor by which all information may be too large.
    initialize : callable
        The initial guess.
    search : callable, optional
        From a minimum in which all edges fit to a lower one, if there is one.
    progress : Progress, optional
        What limits the time. Nothing is returned when it is over.
    """
    progress = progress or Progress()
    whole, trusted = closures.graph, closures.trusted
    present = np.ones(len(whole.edges), np.bool_)
    graph = initialize(whole)
    most = _MAX_OUTLIERS * len(closures)
    for _ in range(_MAX_RELEASED + 1):
        equations = normal_equations(graph, closures.threads)
        graph = _optimized(graph, equations, progress)
        if progress.over:
            return None
        checks = redundancy(graph, equations)
        gate = _gates(checks, trusted[present], scale)
        if gate is None:
            return None
        worst = int(np.argmax(checks.left_out / gate))
        edge = int(np.flatnonzero(present)[worst])
        if not trusted[edge] or checks.left_out[worst] < _FAR * gate[worst]:
            break
        present[edge] = False
        graph = _without(whole, ~present, graph)
        if graph.components.max() > whole.components.max():
            return None
    else:
        return None
    if np.count_nonzero(checks.left_out > gate) > most:
        return None
    if search is not None:
        graph = search(graph)
    scales = checks.scales(trusted[present])
    of_edge = np.full(len(present), np.inf)
    of_edge[present] = gate
    released = np.flatnonzero(~present)
    predicted = np.zeros(len(present))
    predicted[present] = checks.left_out / _OUTLYING
    for _ in range(_MAX_ROUNDS):
        assert graph.poses is not None
        worst_of = np.maximum(chi2_per_edge(whole, graph.poses), predicted)
        outliers = present & ~trusted & (worst_of > of_edge)
        if not outliers.any():
            return Fit(present[closures.edges], graph, scales, released)
        present &= ~outliers
        if np.count_nonzero(~present) > most + len(released):
            return None
        graph = _without(whole, ~present, graph)
        graph = _optimized(graph, normal_equations(graph, closures.threads), progress)
        predicted[:] = 0.0
    return None


def _without(whole: PoseGraph, edges: Flags, at: PoseGraph) -> PoseGraph:
    assert at.poses is not None
    return whole.without_edges(edges).with_poses(at.poses)


def _optimized(graph: PoseGraph, equations: _core.NormalEquations, progress: Progress) -> PoseGraph:
    return optimize(
        graph,
        "dogleg",
        max_iterations=_ITERATIONS,
        relative_tolerance=_TOLERANCE,
        equations=equations,
        progress=progress,
    ).graph


def odometry_allows(closures: Closures) -> float | None:
    """Return a scale if the trusted edges alone contradict next to none of the closures; else None.

    Some thousand closures are looked at. True ones lie within a few gates even where drift is
    large; where pairs of one place agree only to a factor, the gate is wider by it. This factor is
    the scale, at least 1, within which all information may be too large.
    """
    graph = closures.graph
    dof = graph.dof
    trusted = guess_of(graph.without_edges(~closures.trusted), "odometry")
    assert trusted.poses is not None
    pairs = _some(closures.some_pairs)
    scale = 1.0
    if len(pairs) >= _MIN_PAIRS:
        between = agreement(closures, trusted.poses, pairs)
        scale = max(1.0, _CAUTIOUS * scale_of_best_tenth(between, dof))
        if np.mean(between > GATE[dof] * scale) > _MAX_DISAGREEING:
            return None
    chosen = _some(np.arange(len(closures)))
    distance = predict_by_odometry(closures, trusted, chosen).distance
    contradicted = distance > _MAX_DRIFT * GATE[dof] * scale
    if np.count_nonzero(contradicted) > _MAX_OUTLIERS / 2 * len(chosen):
        return None
    return scale


def _some(rows: Ids) -> Ids:
    return rows[:: max(1, len(rows) // _SAMPLE)]


def _gates(checks: Redundancy, trusted: Flags, scale: float) -> Floats | None:
    """Return the chi2 that each edge may have, (m,), or None if the scales contradict."""
    gate = FAR_GATE[checks.dof]
    scales = checks.scales(trusted)
    if scales.trusted and scales.closures:
        ratio = scales.closures / scales.trusted
        exact = checks.left_out.max(initial=0.0) < _EXACT * gate
        if not exact and not 1 / _MAX_RATIO < ratio < _MAX_RATIO:
            return None
    if max(found or 1.0 for found in scales) > _MAX_EXCESS * scale:
        return None
    of_trusted, of_closures = (max(1.0, found or _UNKNOWN) for found in scales)
    return gate * np.where(trusted, of_trusted, of_closures)
