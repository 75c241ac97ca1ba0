"""The table of closures, with the reason for each decision."""

from __future__ import annotations

import numpy as np

from masat.arrays import AnyArray, Flags, Floats, Ids
from masat.graph import PoseGraph
from masat.residuals import chi2_per_edge
from masat.robust.closures import GATE, Closures
from masat.robust.growth import NEAR, Growth
from masat.robust.hypothesis import Hypothesis
from masat.robust.prediction import predict

TABLE = np.dtype(
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

RELEASED = "trusted, but all closures across it contradict it"


def table_of(hypothesis: Hypothesis, trusted: Flags, *, interrupted: bool = False) -> AnyArray:
    """Return the table of a hypothesis: a row for each edge that was not trusted, or no longer is.

    Parameters
    ----------
    hypothesis : Hypothesis
        The decision.
    trusted : ndarray of bool, (m,)
        The edges that were to be trusted.
    interrupted : bool
        Whether the time was over before all was judged.
    """
    closures, growth = hypothesis.closures, hypothesis.growth
    kept = growth.kept
    judged = _rows(closures, closures.edges, growth.poses)
    judged["chi2"] *= hypothesis.used.closures or 1.0
    judged["kept"] = kept
    judged["distance"] = np.where(kept, np.nan, growth.distance)
    judged["log_ratio"] = np.where(kept, np.nan, growth.log_ratio)
    judged["cluster"] = growth.runs
    judged["reason"] = _reasons(closures, growth, hypothesis.first)
    if interrupted:
        judged["reason"][~kept] = "not judged: the time was over"
    judged["reason"][trusted[closures.edges] & ~kept] = RELEASED
    joining = _rows(closures, np.flatnonzero(closures.trusted & ~trusted), growth.poses)
    joining["chi2"] *= hypothesis.used.trusted or 1.0
    joining["kept"] = True
    joining["cluster"] = -1
    joining["reason"] = "kept: joins parts that no trusted edge connects"
    table = np.concatenate([judged, joining])
    return table[np.argsort(table["edge"])]


def table_of_fit(closures: Closures, kept: Flags, graph: PoseGraph, released: Ids) -> AnyArray:
    """Return the table where all but a few outliers fit the map that they make."""
    assert graph.poses is not None
    table = _rows(closures, closures.edges, graph.poses)
    table["kept"] = kept
    table["cluster"] = -1
    table["reason"] = np.where(kept, "kept", "contradicts the rest of the map")
    outliers = np.flatnonzero(~kept)
    if len(outliers):
        table["distance"][outliers], table["log_ratio"][outliers] = predict(
            closures, graph, outliers
        )
    slips = _rows(closures, released, graph.poses)
    slips["cluster"] = -1
    slips["reason"] = RELEASED
    table = np.concatenate([table, slips])
    return table[np.argsort(table["edge"])]


def _reasons(closures: Closures, growth: Growth, first: Floats) -> AnyArray:
    """Return why each closure is kept or rejected, (c,)."""
    gate = GATE[closures.graph.dof]
    reasons = np.full(len(closures), "kept", "U60")
    rejected = ~growth.kept
    within = growth.distance < gate
    reasons[rejected] = "contradicts the trusted edges"
    allowed = np.flatnonzero(rejected & (first < gate))
    # Closures of a group contradict the same ones.
    _, one, group = np.unique(
        growth.representative[allowed], return_index=True, return_inverse=True
    )
    why = np.array([_contradicted(closures, growth, k) for k in allowed[one].tolist()], "U60")
    reasons[allowed] = why[group]
    reasons[rejected & within] = "undecided: as likely false as true"
    reasons[rejected & within & ~growth.supported] = "unsupported: no other closure agrees with it"
    return reasons


def _contradicted(closures: Closures, growth: Growth, rejected: int) -> str:
    """Say which cluster a closure contradicts that the trusted edges alone allow."""
    kept = np.flatnonzero(growth.kept)
    near = (np.abs(closures.ends[kept] - closures.ends[rejected]) <= NEAR).any(axis=1)
    size = np.bincount(growth.runs[kept[near]], minlength=1)
    largest = int(size.argmax())
    own = int(np.count_nonzero(growth.runs == growth.runs[rejected]))
    if size[largest] <= own or largest == growth.runs[rejected]:
        return "contradicts the closures that are kept"
    return f"contradicts the map beside cluster {largest}, which is larger"


def _rows(closures: Closures, edges: Ids, poses: Floats) -> AnyArray:
    rows = np.zeros(len(edges), TABLE)
    rows["edge"] = edges
    rows["from"], rows["to"] = closures.graph.edges[edges].T
    rows["chi2"] = chi2_per_edge(closures.graph, poses)[edges]
    rows["distance"] = rows["log_ratio"] = np.nan
    return rows
