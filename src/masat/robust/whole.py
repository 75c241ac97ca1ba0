"""The first hypothesis: all closures are true, but for a few outliers."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from masat import _core
from masat.arrays import Flags, Floats, Ids
from masat.graph import PoseGraph
from masat.initializers import guess_of
from masat.optimizers import optimize
from masat.optimizers.equations import normal_equations
from masat.residuals import chi2_per_edge
from masat.robust.closures import FAR_GATE, GATE, QUARTILE, Closures
from masat.robust.prediction import agreement, predict_by_odometry
from masat.robust.redundancy import Redundancy, Scales, redundancy

# Fraction of the closures that may be outliers of a map that is not in doubt.
_MAX_OUTLIERS = 0.02
_MAX_ROUNDS = 3
# Closures whose information is off by more, against that of the trusted edges, are judged with
# another one.
_MAX_RATIO, _EXACT = 10.0, 1e-6
# Factor by which all information may be too large, and by which it may be off where nothing tells.
_MAX_PROMISE = 50.0
_UNKNOWN = 4.0
# Closures and pairs that are looked at before anything is optimized.
_SAMPLE, _MIN_PAIRS = 2000, 10
# The variance of a pair's cycle is estimated too large by about this factor.
_CAUTIOUS = 4.0
# Fraction of the pairs that may disagree, and gates that drift may take a true closure away.
_MAX_DISAGREEING, _MAX_DRIFT = 0.05, 10.0
_TOLERANCE, _ITERATIONS = 1e-6, 30


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
    """

    kept: Flags
    graph: PoseGraph
    scales: Scales


def fit_of_all(closures: Closures, start: Callable[[PoseGraph], PoseGraph]) -> Fit | None:
    """Return the map of all closures, if all but a few fit together; else None.

    Each edge is compared with what all others predict, with the information given; where it
    promises too much by a common factor, with the factor that fits. False closures leave
    contradictions beyond that, even where the optimization has spread them.

    Parameters
    ----------
    closures : Closures
        The closures.
    start : callable
        The initial guess.
    """
    if not odometry_allows(closures):
        return None
    graph = start(closures.graph)
    equations = normal_equations(graph)
    graph = _optimized(graph, equations)
    checks = redundancy(graph, equations)
    trusted = closures.trusted
    gate = _gates(checks, trusted)
    most = _MAX_OUTLIERS * len(closures)
    if gate is None or np.count_nonzero(checks.left_out > gate) > most:
        return None
    scales = checks.scales(trusted)
    kept = np.ones(len(closures), np.bool_)
    chi2 = checks.chi2
    for _ in range(_MAX_ROUNDS):
        outliers = kept & (chi2 > gate)[closures.edges]
        if not outliers.any():
            return Fit(kept, graph, scales)
        kept &= ~outliers
        if np.count_nonzero(~kept) > most:
            return None
        assert graph.poses is not None
        graph = closures.graph_with(kept, graph.poses)
        graph = _optimized(graph, normal_equations(graph))
        chi2 = chi2_per_edge(closures.graph, graph.poses)
    return None


def _optimized(graph: PoseGraph, equations: _core.NormalEquations) -> PoseGraph:
    return optimize(
        graph,
        "dogleg",
        max_iterations=_ITERATIONS,
        relative_tolerance=_TOLERANCE,
        equations=equations,
    ).graph


def odometry_allows(closures: Closures) -> bool:
    """Return whether the trusted edges alone contradict next to none of the closures.

    Some thousand closures are looked at. True ones lie within a few gates even where drift is
    large; where pairs of one place agree only to a factor, the gate is wider by it.
    """
    graph = closures.graph
    dof = graph.dof
    trusted = guess_of(graph.without_edges(~closures.trusted), "odometry")
    assert trusted.poses is not None
    pairs = _some(closures.pairs)
    scale = 1.0
    if len(pairs) >= _MIN_PAIRS:
        between = agreement(closures, trusted.poses, pairs)
        scale = max(1.0, _CAUTIOUS * float(np.quantile(between, 0.25)) / QUARTILE[dof])
        if np.mean(between > GATE[dof] * scale) > _MAX_DISAGREEING:
            return False
    chosen = _some(np.arange(len(closures)))
    distance = predict_by_odometry(closures, trusted, chosen).distance
    contradicted = distance > _MAX_DRIFT * GATE[dof] * scale
    return int(np.count_nonzero(contradicted)) <= _MAX_OUTLIERS / 2 * len(chosen)


def _some(rows: Ids) -> Ids:
    return rows[:: max(1, len(rows) // _SAMPLE)]


def _gates(checks: Redundancy, trusted: Flags) -> Floats | None:
    """Return the chi2 that each edge may have, (m,), or None if the scales contradict."""
    gate = FAR_GATE[checks.dof]
    scales = checks.scales(trusted)
    if scales.trusted and scales.closures:
        ratio = scales.closures / scales.trusted
        exact = checks.left_out.max(initial=0.0) < _EXACT * gate
        if not exact and not 1 / _MAX_RATIO < ratio < _MAX_RATIO:
            return None
    if max(scale or 1.0 for scale in scales) > _MAX_PROMISE:
        return None
    of_trusted, of_closures = (max(1.0, scale or _UNKNOWN) for scale in scales)
    return gate * np.where(trusted, of_trusted, of_closures)
