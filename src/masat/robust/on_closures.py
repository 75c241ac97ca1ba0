"""The decision which loop closures to keep."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from masat.arrays import Flags, locked
from masat.graph import PoseGraph
from masat.initializers.chordal import chordal
from masat.progress import Progress
from masat.quantiles import FAR_GATE, GATE
from masat.residuals import chi2_per_edge
from masat.robust.closures import Closures
from masat.robust.decision import Decision, RunnerUp
from masat.robust.hypothesis import Hypothesis, best_scaled
from masat.robust.objective import cost
from masat.robust.parts import joining_closures
from masat.robust.scales import Scales
from masat.robust.slips import suspected_slip
from masat.robust.table import table_of, table_of_fit
from masat.robust.whole import Fit, Guess, fit_of_all, odometry_allows

# Trusted edges that may be released, and the gates that one has to save.
_MAX_RELEASED, _PRICE_OF_RELEASE = 5, 2.0
# Fraction of the closures that has to be in doubt for the trusted edges to be, and operations of
# all closures together, over those of the kept ones, that are worth it.
_MIN_DOUBTFUL, _MAX_OPERATIONS = 0.01, 5.0
# Operations of a factorization above which not all closures are optimized together: false ones can
# make the system dense.
_EXPENSIVE = 5e9
# Of so many closures it is worth a note if less than this fraction is kept.
_MIN_CLOSURES, _FEW_KEPT = 10, 0.1
# Gates by which chi2 of the trusted edges alone may exceed what is expected.
_CONTRADICTION = 4.0
# A second hypothesis whose cost is higher by no more than so many gates is near.
_NEAR = 2.0


def decide_on_closures(
    graph: PoseGraph,
    trusted: ArrayLike | None = None,
    *,
    initialize: Guess = chordal,
    search: Guess | None = None,
    believed: Flags | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Decision:
    """Decide which loop closures of a graph to believe.

    If all closures fit together but for a few outliers, they are kept (`whole.fit_of_all`).
    Otherwise a map grows from the trusted edges by the closures that it predicts best
    (`growth.Growth`); then groups of closures are added or taken out where that lowers the cost
    (`moves.improve`). If the information of the trusted edges or of the closures is off by a common
    factor, this is repeated with another one, and the decision of the lowest cost counts.

    Parameters
    ----------
    graph : PoseGraph
        The graph; its poses do not count.
    trusted : array_like of bool, (m,), optional
        The edges to trust. Default: odometry, the first edge of each pair of consecutive ids.
        Parts that they leave unconnected are joined by the closures that agree with most others.
    initialize : callable, optional
        The initial guess of all edges, where the trusted ones do not contradict the others.
    search : callable, optional
        From a minimum in which all edges fit to a lower one, if there is one. Default: no search.
    believed : ndarray of bool, (m,), optional
        Edges that an earlier decision believed: the map begins with them, and may reject them.
    threads : int, optional
        Threads that compute. The decision does not depend on it. Default: as many as pay.
    progress : Progress, optional
        What reports the stages and limits the time.

    Returns
    -------
    Decision

    Raises
    ------
    OptimizationError
        If no edge is trusted, or the mask has another shape.
    """
    progress = progress or Progress()
    closures = Closures(graph, trusted, threads)
    progress.tell("comparing all loop closures with each other")
    joining = joining_closures(closures)
    joined = closures.trusted.copy()
    joined[joining] = True
    # Trusted edges contradict no closure between parts that they leave unconnected.
    connected = closures if len(joining) == 0 else Closures(graph, joined)
    fit_all = partial(fit_of_all, initialize=initialize, search=search, progress=progress)
    cheap = closures.graph.elimination.operations(graph.dof) < _EXPENSIVE
    scale = odometry_allows(connected)
    fit = fit_all(closures, scale) if scale is not None and cheap else None
    if fit is not None and len(fit.released) == 0:
        return _decision_of_fit(closures, fit)
    try:
        best = best_scaled(graph, joined, progress, threads, believed)
    except KeyboardInterrupt:
        if fit is None:
            raise
        progress.interrupt()
        return _decision_of_fit(closures, fit)
    try:
        best = _without_slips(best, closures, progress)
        if scale is None and not progress.over and _may_all_fit(closures, best):
            # Perhaps a trusted edge is wrong, and the closures are not.
            fit = fit_all(closures)
    except KeyboardInterrupt:
        progress.interrupt()
    whole = None if fit is None else _decision_of_fit(closures, fit)
    if whole is not None and whole.cost < best.cost:
        return whole
    return _decision(best, closures.trusted, progress.over)


def _without_slips(best: Hypothesis, closures: Closures, progress: Progress) -> Hypothesis:
    """Return a hypothesis without trusted edges that are better released, if there are any."""
    graph, trusting = closures.graph, closures.trusted.copy()
    for _ in range(_MAX_RELEASED):
        slip = suspected_slip(best.closures, best.growth)
        if slip is None or progress.over:
            break
        a, b = graph.edges[slip]
        progress.tell(f"trying without the trusted edge {a} -> {b}")
        trusting[slip] = False
        rest = trusting.copy()
        rest[joining_closures(Closures(graph, rest))] = True
        try:
            without = best_scaled(graph, rest, progress, closures.threads)
        except KeyboardInterrupt:
            progress.interrupt()
            break
        saved = best.cost - without.cost
        if saved < _PRICE_OF_RELEASE * FAR_GATE[graph.dof] or _new_clusters(best, without) < 2:
            break
        best = without
    return best


def _may_all_fit(closures: Closures, best: Hypothesis) -> bool:
    """Return whether many rejected closures agree, and all together are cheap to optimize."""
    growth, dof = best.growth, closures.graph.dof
    doubtful = ~growth.kept & growth.supported
    if np.count_nonzero(doubtful) <= _MIN_DOUBTFUL * len(closures):
        return False
    operations = closures.graph.elimination.operations(dof)
    return bool(operations <= _MAX_OPERATIONS * growth.map.elimination.operations(dof))


def _new_clusters(best: Hypothesis, other: Hypothesis) -> int:
    """Return how many clusters another hypothesis believes that the best one rejects."""
    believed = other.closures.kept_edges(other.growth.kept)[best.closures.edges]
    return len(np.unique(best.growth.runs[believed & ~best.growth.kept]))


def _decision_of_fit(closures: Closures, fit: Fit) -> Decision:
    kept, poses = fit.kept, fit.graph.poses
    assert poses is not None
    chi2 = chi2_per_edge(closures.graph, poses)
    in_map = closures.kept_edges(kept)
    in_map[fit.released] = False
    chi2[fit.released] = _PRICE_OF_RELEASE * FAR_GATE[closures.graph.dof]
    return Decision(
        kept=locked(in_map),
        closures=locked(table_of_fit(closures, kept, fit.graph, fit.released)),
        cost=cost(closures, kept, chi2),
        scales=fit.scales,
        used=Scales(1.0, 1.0),
        released=locked(fit.released),
        runner_up=None,
        poses=locked(poses),
        from_start=True,
    )


def _decision(best: Hypothesis, trusted: Flags, interrupted: bool) -> Decision:
    closures, growth = best.closures, best.growth
    kept = closures.kept_edges(growth.kept)
    return Decision(
        kept=locked(kept),
        closures=locked(table_of(best, trusted, interrupted=interrupted)),
        cost=best.cost,
        scales=best.scales,
        used=best.used,
        released=locked(np.flatnonzero(trusted & ~kept)),
        runner_up=_runner_up(best),
        poses=locked(growth.poses),
        notes=_notes(best),
    )


def _notes(best: Hypothesis) -> tuple[str, ...]:
    """Say what makes a decision doubtful."""
    graph, dof = best.closures.graph, best.closures.graph.dof
    trusted = int(best.closures.trusted.sum())
    redundant = dof * (trusted - (len(graph) - len(graph.gauge)))
    notes: list[str] = []
    kept, count = int(best.growth.kept.sum()), len(best.closures)
    if count >= _MIN_CLOSURES and kept < _FEW_KEPT * count:
        notes.append(
            f"only {kept} of {count} loop closures are kept: either most of them are false, or the "
            "trusted edges are wrong in places or worse than their information says"
        )
    expected = max(redundant, 0) + _CONTRADICTION * FAR_GATE[dof]
    if best.alone <= expected:
        return tuple(notes)
    cause = "the fixed nodes, whose poses may be wrong" if len(graph.fixed) > 1 else "each other"
    notes.append(
        f"the trusted edges alone contradict {cause} (chi2 {best.alone:.3g}, where "
        f"{max(redundant, 0)} is expected): closures cannot be judged well against them"
    )
    return tuple(notes)


def _runner_up(best: Hypothesis) -> RunnerUp | None:
    other, closures = best.decided.other, best.closures
    if other is None or (other == best.growth.kept).all():
        return None
    total = best.decided.other_cost + best.price_of_scales
    if total > best.cost + _NEAR * GATE[closures.graph.dof]:
        return None
    return RunnerUp(locked(closures.kept_edges(other)), total)
