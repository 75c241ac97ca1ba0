"""What a robust solve decided: the rows that are printed, and the file of what it rejects."""

from __future__ import annotations

import numpy as np

from masat.arrays import AnyArray
from masat.graph import PoseGraph
from masat.measurements import landmarks
from masat.optimizers import Result
from masat.robust.decision import Decision

# Rejected measurements of one reason that are named; the others are only counted.
_MAX_NAMED = 3


def rejected_part(graph: PoseGraph, result: Result) -> PoseGraph:
    """Return the nodes of a solved graph with only those measurements that were rejected.

    Landmarks are those that a rejected observation or prior names. All are where the map has them.
    """
    decision = result.decision
    assert decision is not None
    # Measurements of the graph go first, so that landmarks can go.
    out = graph.without_edges(decision.kept).with_priors(None).with_landmarks(None).with_fixed([])
    out = out.with_poses(result.poses)
    priors = None if graph.priors is None else graph.priors.rows(~decision.kept_priors)
    if graph.landmarks is not None:
        seen = graph.landmarks.observed(~decision.kept_observations)
        named = seen.observations[:, 1]
        if priors is not None:
            named = np.concatenate([named, priors.ids])
        rows = np.isin(seen.ids, named)
        points = result.graph.points
        if rows.any():
            out = out.with_landmarks(
                landmarks(
                    seen.observations,
                    seen.measurements,
                    seen.information,
                    ids=seen.ids[rows],
                    positions=None if points is None else points[rows],
                )
            )
    return out.with_priors(priors)


def rows_of_decision(result: Result) -> list[tuple[str, str]]:
    """Return what to say of a robust decision: counts, scales and what is rejected, by reason."""
    decision = result.decision
    if decision is None:
        return []
    table = decision.closures
    rows = [("loop closures", f"{_kept(table)}; cost {decision.cost:.6g}")]
    for kind in ("prior", "observation"):
        own = decision.measurements[decision.measurements["kind"] == kind]
        if len(own):
            rows.append((f"{kind}s", _kept(own)))
    for name, scale, used in zip(
        ("trusted edges", "loop closures"), decision.scales, decision.used, strict=True
    ):
        if scale is not None:
            judged = "" if used == 1 else f", judged with {used:.3g}"
            rows.append(("scale", f"covariances of {name} {scale:.3g} times what they say{judged}"))
    rows += _rejected_closures(table)
    rows += _rejected_measurements(decision.measurements)
    return rows + _runner_up(decision)


def _kept(table: AnyArray) -> str:
    return f"{int(table['kept'].sum())} of {len(table)} kept"


def _rejected_closures(table: AnyArray) -> list[tuple[str, str]]:
    rejected = table[~table["kept"]]
    kinds = [reason.partition(" cluster ")[0] for reason in rejected["reason"].tolist()]
    rows = []
    for kind in sorted(set(kinds)):
        own = rejected[[other == kind for other in kinds]]
        reason = own["reason"][0] if len(set(own["reason"].tolist())) == 1 else kind
        if reason == "contradicts the map beside":
            reason += " a larger cluster"
        named = [f"{a} -> {b}" for a, b in zip(own["from"], own["to"], strict=True)]
        rows.append(("rejected", f"{len(own)}: {reason} ({_some(named)})"))
    return rows


def _rejected_measurements(table: AnyArray) -> list[tuple[str, str]]:
    rows = []
    for kind, reason in sorted(
        {(kind, reason) for kind, kept, reason in table[["kind", "kept", "reason"]] if not kept}
    ):
        own = table[(table["kind"] == kind) & ~table["kept"] & (table["reason"] == reason)]
        named = [
            f"node {node}" if kind == "prior" else f"{node} -> {landmark}"
            for node, landmark in zip(own["node"], own["landmark"], strict=True)
        ]
        noun = kind if len(own) == 1 else f"{kind}s"
        rows.append(("rejected", f"{len(own)} {noun}: {reason} ({_some(named)})"))
    return rows


def _some(named: list[str]) -> str:
    return ", ".join(named[:_MAX_NAMED]) + (", ..." if len(named) > _MAX_NAMED else "")


def _runner_up(decision: Decision) -> list[tuple[str, str]]:
    other = decision.runner_up
    if other is None:
        return []
    keeps = int((other.kept & ~decision.kept).sum())
    rejects = int((decision.kept & ~other.kept).sum())
    said = f"cost {other.cost:.6g}: {keeps} more kept, {rejects} more rejected"
    return [("nearly as likely", said)]
