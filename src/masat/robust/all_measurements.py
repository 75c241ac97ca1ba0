"""The decision which measurements of a graph to believe: loop closures first, then the others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from masat.arrays import AnyArray, Flags, Floats, Ids, locked
from masat.assembly import Assembly, assemble, needs_assembly, relative_part
from masat.chain import odometry_edges
from masat.graph import PoseGraph
from masat.information import partial
from masat.initializers.chordal import chordal
from masat.progress import Progress
from masat.residuals import chi2_per_edge
from masat.robust.closures import checked_trusted
from masat.robust.decision import MEASUREMENTS, Decision
from masat.robust.judgement import Judgement, judge
from masat.robust.on_closures import decide_on_closures
from masat.robust.scales import Scales
from masat.robust.table import TABLE
from masat.robust.whole import Guess

# Of so many measurements it is worth a note if less than this fraction is kept.
_MIN_COUNT, _FEW_KEPT = 10, 0.6
_CONTRADICTS = "contradicts the rest of the map"


def decide(
    graph: PoseGraph,
    trusted: ArrayLike | None = None,
    *,
    initialize: Guess = chordal,
    search: Guess | None = None,
    believed: Flags | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Decision:
    """Decide which loop closures, priors, observations and partial edges of a graph to believe.

    Loop closures of full information are judged by each other and by the trusted edges. In the map
    of those that are kept, priors, observations of landmarks and partial edges are judged by each
    other: most of them have to be right.

    Parameters
    ----------
    graph : PoseGraph
        The graph; its poses do not count, but for those of fixed nodes.
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
    mask = checked_trusted(graph, odometry_edges(graph) if trusted is None else trusted)
    is_full = np.ones(len(graph.edges), np.bool_)
    is_full[partial(graph.information)] = False
    full = np.flatnonzero(is_full)
    relative = relative_part(graph)
    if len(full):
        decision = decide_on_closures(
            relative,
            mask[full],
            initialize=initialize,
            search=search,
            believed=None if believed is None else believed[full],
            threads=threads,
            progress=progress,
        )
        decision = _in_whole_graph(decision, graph, full)
    else:
        decision = _nothing_decided(chordal(relative))
    if not needs_assembly(graph):
        return decision
    progress.tell("comparing priors and landmarks with the map")
    assembly = assemble(graph.without_edges(~decision.kept))
    edges = np.flatnonzero(decision.kept)
    doubtful = np.ones(assembly.measured, np.bool_)
    doubtful[: len(edges)] = ~is_full[edges] & ~mask[edges]
    poses = decision.poses
    judged = judge(
        assembly,
        doubtful,
        lambda relative: relative.with_poses(poses),
        threads=threads,
        progress=progress,
    )
    return _with_judgement(decision, assembly, doubtful, judged, edges)


def _in_whole_graph(decision: Decision, graph: PoseGraph, rows: Ids) -> Decision:
    """Return a decision on some edges of a graph as one on all of them."""
    if len(rows) == len(graph.edges):
        return decision
    kept = np.ones(len(graph.edges), np.bool_)
    kept[rows] = decision.kept
    closures = decision.closures.copy()
    closures["edge"] = rows[closures["edge"]]
    runner_up = decision.runner_up
    if runner_up is not None:
        other = np.ones(len(graph.edges), np.bool_)
        other[rows] = runner_up.kept
        runner_up = runner_up._replace(kept=locked(other))
    return replace(
        decision,
        kept=locked(kept),
        closures=locked(closures),
        released=locked(rows[decision.released]),
        runner_up=runner_up,
    )


def _nothing_decided(guess: PoseGraph) -> Decision:
    assert guess.poses is not None
    return Decision(
        kept=locked(np.ones(len(guess.edges), np.bool_)),
        closures=locked(np.zeros(0, TABLE)),
        cost=0.0,
        scales=Scales(None, None),
        used=Scales(1.0, 1.0),
        released=locked(np.empty(0, np.int64)),
        runner_up=None,
        poses=guess.poses,
    )


def _with_judgement(
    decision: Decision, assembly: Assembly, doubtful: Flags, judged: Judgement, edges: Ids
) -> Decision:
    """Return a decision with what is believed beside the loop closures."""
    source, nodes = assembly.source, judged.poses
    chi2 = chi2_per_edge(assembly.graph, nodes)[: assembly.measured]
    kept = decision.kept.copy()
    own = len(source.edges)
    kept[edges] = judged.kept[:own]
    partly = np.flatnonzero(doubtful[:own])
    rows = np.zeros(len(partly), TABLE)
    rows["edge"] = edges[partly]
    rows["from"], rows["to"] = source.edges[partly].T
    rows["kept"], rows["chi2"] = judged.kept[partly], chi2[partly]
    rows["log_ratio"], rows["cluster"] = np.nan, -1
    rows["distance"] = np.where(rows["kept"], np.nan, judged.distance[partly])
    rows["reason"] = np.where(rows["kept"], "kept", _CONTRADICTS)
    closures = np.concatenate([decision.closures, rows])
    table = _table(assembly, judged, chi2)
    points = nodes[assembly.points_at, : source.dimension]
    return replace(
        decision,
        kept=locked(kept),
        closures=locked(closures[np.argsort(closures["edge"], kind="stable")]),
        measurements=locked(table),
        poses=locked(nodes[assembly.poses_at]),
        points=None if source.landmarks is None else locked(points),
        from_start=False,
        notes=(*decision.notes, *_notes(table)),
    )


def _table(assembly: Assembly, judged: Judgement, chi2: Floats) -> AnyArray:
    """Return a row for each prior and each observation."""
    parts = []
    for kind, rows in (("prior", assembly.prior_rows), ("observation", assembly.observation_rows)):
        table = np.zeros(rows.stop - rows.start, MEASUREMENTS)
        table["kind"], table["row"] = kind, np.arange(len(table))
        ends = assembly.graph.edges[rows]
        table["node"] = ends[:, 1 if kind == "prior" else 0]
        table["landmark"] = -1 if kind == "prior" else ends[:, 1]
        table["kept"], table["chi2"] = judged.kept[rows], chi2[rows]
        table["distance"] = judged.distance[rows]
        table["reason"] = np.where(table["kept"], "kept", _CONTRADICTS)
        parts.append(table)
    return np.concatenate(parts)


def _notes(table: AnyArray) -> list[str]:
    """Say where so few measurements are kept that the others may be the right ones."""
    notes = []
    for kind in ("prior", "observation"):
        own = table[table["kind"] == kind]
        kept = int(own["kept"].sum())
        if len(own) >= _MIN_COUNT and kept < _FEW_KEPT * len(own):
            notes.append(
                f"only {kept} of {len(own)} {kind}s are kept: either many of them are wrong, or "
                "their information is too large, or the rest of the map is wrong"
            )
    return notes
