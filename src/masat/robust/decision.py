"""The decision which closures to keep, and why the others are rejected."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from masat.arrays import AnyArray, Flags, Floats, locked
from masat.errors import InitializationError, OptimizationError
from masat.graph import PoseGraph
from masat.progress import Progress
from masat.robust.closures import GATE, Closures
from masat.robust.growth import Growth
from masat.robust.moves import improve
from masat.robust.objective import cost
from masat.robust.prediction import agreement

# Quartiles of chi2 for 3 and 6 degrees of freedom: the lower one and the median.
_QUARTILE, _MEDIAN = {3: 1.213, 6: 3.455}, {3: 2.366, 6: 5.348}
# The information of the closures is rescaled where it seems off by more than this factor.
# At most by the second at once.
_MAX_SCALE_ERROR, _MAX_FACTOR = 4.0, 100.0
_MIN_COUNT, _MAX_SCALES = 10, 3

_TABLE = np.dtype(
    [
        ("edge", np.int64),
        ("from", np.int64),
        ("to", np.int64),
        ("kept", np.bool_),
        ("chi2", np.float64),
        ("distance", np.float64),
        ("log_ratio", np.float64),
        ("cluster", np.int64),
        ("reason", "U60"),
    ]
)


@dataclass(frozen=True, eq=False, repr=False)
class Decision:
    """Which loop closures of a graph to believe.

    Attributes
    ----------
    kept : ndarray of bool, (m,)
        Which edges of the graph are kept; the trusted ones always are.
    closures : structured ndarray, (c,)
        A row for each edge that is not trusted: `edge` (its index), `from`, `to`, `kept`, `chi2`
        (in the final map, with the information given), `distance` (squared Mahalanobis distance
        from the prediction, with the scaled information; NaN for kept ones), `log_ratio`
        (logarithm of the likelihood ratio against a false closure; NaN for kept ones), `cluster`
        (closures of one place that agree), `reason`.
    cost : float
        chi2 of the trusted edges and of the kept closures, with the scaled information, and the
        price of the rejected ones (`masat.robust.objective`).
    scale : float
        The estimated factor by which the covariances of the closures exceed what their information
        says; 1 if it seems right.
    poses : ndarray, (n, 3) or (n, 7)
        The map of the decision, near its minimum.
    """

    kept: Flags
    closures: AnyArray
    cost: float
    scale: float
    poses: Floats

    def __repr__(self) -> str:
        believed = int(self.closures["kept"].sum())
        return f"Decision({believed} of {len(self.closures)} loop closures kept)"

    def to_dict(self) -> dict[str, Any]:
        """Return what JSON says of a decision."""
        rejected = self.closures[~self.closures["kept"]]
        return {
            "closures": len(self.closures),
            "kept": int(self.closures["kept"].sum()),
            "cost": self.cost,
            "scale": self.scale,
            "rejected": [
                {
                    name: row[name].item()
                    for name in ("edge", "from", "to", "chi2", "cluster", "reason")
                }
                for row in rejected
            ],
        }


def decide(
    graph: PoseGraph,
    trusted: ArrayLike | None = None,
    *,
    progress: Progress | None = None,
) -> Decision:
    """Decide which loop closures of a graph to believe.

    A map grows from the trusted edges by the closures that it predicts best (`growth.Growth`); then
    whole clusters are added or taken out where that lowers the cost (`moves.improve`). If the
    information of the closures seems wrong by a common factor, it is rescaled, and the decision
    with the lower cost counts.

    Parameters
    ----------
    graph : PoseGraph
        The graph; its poses do not count.
    trusted : array_like of bool, (m,), optional
        The edges to trust. Default: odometry, the first edge of each pair of consecutive ids.
    progress : Progress, optional
        What reports the stages and limits the time.

    Returns
    -------
    Decision

    Raises
    ------
    OptimizationError
        If no edge is trusted, or the trusted edges do not connect the graph.
    """
    progress = progress or Progress()
    closures = Closures(graph, trusted)
    _check_connected(closures)
    best = last = _decided(closures, 1.0, progress)
    for _ in range(_MAX_SCALES):
        factor = _scale_error(closures, last)
        if factor == 1.0 or progress.over:
            break
        scale = last.scale * factor
        progress.tell(f"trying closures with {scale:.3g} times their covariance")
        scaled = Closures(_rescaled(graph, closures, scale), closures.trusted)
        try:
            last = _decided(scaled, scale, progress)
        except KeyboardInterrupt:
            progress.interrupt()
            break
        except (OptimizationError, InitializationError):
            break
        best = min(best, last, key=lambda decision: decision.cost)
    return best


def _decided(closures: Closures, scale: float, progress: Progress) -> Decision:
    growth = Growth(closures, progress)
    first = growth.distance.copy()
    try:
        growth.grow()
        growth = improve(closures, growth, first, progress).growth
        growth.describe()
    except KeyboardInterrupt:
        progress.interrupt()
    chi2 = growth.chi2
    total = cost(closures, growth.kept, chi2)
    # The likelihood of the kept closures also has their wider covariances.
    total += closures.graph.dof * np.log(scale) * int(growth.kept.sum())
    table = np.empty(len(closures), _TABLE)
    table["edge"] = closures.edges
    table["from"], table["to"] = closures.graph.edges[closures.edges].T
    table["kept"] = growth.kept
    table["chi2"] = chi2[closures.edges] * scale
    table["distance"] = np.where(growth.kept, np.nan, growth.distance)
    table["log_ratio"] = np.where(growth.kept, np.nan, growth.log_ratio)
    table["cluster"] = growth.runs
    table["reason"] = _reasons(closures, growth, first)
    if progress.over:
        table["reason"][~growth.kept] = "not judged: the time was over"
    return Decision(
        kept=locked(closures.kept_edges(growth.kept)),
        closures=locked(table),
        cost=total,
        scale=scale,
        poses=locked(growth.poses),
    )


def _reasons(closures: Closures, growth: Growth, first: Floats) -> AnyArray:
    """Return why each closure is kept or rejected, (c,)."""
    gate = GATE[closures.graph.dof]
    reasons = np.full(len(closures), "kept", "U60")
    rejected = ~growth.kept
    within = growth.distance < gate
    reasons[rejected] = "contradicts the trusted edges"
    reasons[rejected & (first < gate)] = "contradicts the closures that are kept"
    reasons[rejected & within] = "undecided: as likely false as true"
    reasons[rejected & within & ~growth.supported] = "unsupported: no other closure agrees with it"
    return reasons


def _scale_error(closures: Closures, decision: Decision) -> float:
    """Return a factor by which the closures' covariances seem wrong in a decision, or 1."""
    dof, table = closures.graph.dof, decision.closures
    kept = table["kept"]
    between = agreement(closures, decision.poses) / decision.scale
    if int(kept.sum()) >= max(_MIN_COUNT, len(closures) // 2):
        factor = float(np.median(table["chi2"][kept])) / _MEDIAN[dof] / decision.scale
        # A closure of a long loop fits almost by itself: only if others of its place agree as well.
        if factor < 1 and len(between) >= _MIN_COUNT:
            factor = max(factor, float(np.median(between)) / _MEDIAN[dof])
        elif factor < 1:
            return 1.0
    elif len(between) >= _MIN_COUNT:
        # Few were believed: perhaps since their information is too large.
        factor = max(1.0, float(np.quantile(between, 0.25)) / _QUARTILE[dof])
    else:
        return 1.0
    factor = float(np.clip(factor, 1 / _MAX_FACTOR, _MAX_FACTOR))
    return factor if max(factor, 1 / factor) > _MAX_SCALE_ERROR else 1.0


def _rescaled(graph: PoseGraph, closures: Closures, scale: float) -> PoseGraph:
    information = graph.information.copy()
    information[closures.edges] /= scale
    return replace(graph, information=information)


def _check_connected(closures: Closures) -> None:
    graph = closures.graph
    trusted = graph.without_edges(~closures.trusted)
    labels, whole = trusted.components, graph.components
    if labels.max() == whole.max():
        return
    i, j = closures.ends.T
    k = int(np.flatnonzero(labels[i] != labels[j])[0])
    a, b = graph.ids[closures.ends[k]]
    raise OptimizationError(
        f"the trusted edges leave {labels.max() + 1} parts without a connection, such as those of "
        f"nodes {a} and {b}: closures between them cannot be judged; trust an edge between them"
    )
