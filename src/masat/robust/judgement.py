"""Which priors, observations of landmarks and partial edges to believe, given the relative map."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from masat.arrays import Flags, Floats, Ids
from masat.assembly import AssembledGraph, Assembly
from masat.graph import PoseGraph
from masat.initializers import guess_of_assembly
from masat.initializers.placing import placed_assembly
from masat.optimizers import optimize
from masat.optimizers.equations import normal_equations
from masat.progress import Progress
from masat.quantiles import FAR_GATE, QUARTER
from masat.redundancy import whitened
from masat.residuals import chi2_per_edge

# Weight of measurements that are not in the map: they still determine what nothing else does.
_ABSENT = 1e-9
# Rounds until no measurement changes sides. Each takes out the worse half of what is outlying.
_MAX_ROUNDS = 40
# Times that a measurement may come back.
_MAX_RETURNS = 2
_TOLERANCE, _ITERATIONS = 1e-4, 30
# Measurements of a kind that tell whether its information is too large.
_MIN_FOR_SCALE = 10
# Eigenvalues of an information matrix below this fraction of the largest count as zero.
_NO_INFORMATION = 1e-12


class Judgement(NamedTuple):
    """What is believed beside the trusted measurements.

    Attributes
    ----------
    kept : ndarray of bool, (m,)
        The measurements of the assembled graph, in its order: the trusted ones, and those that are
        believed.
    distance : ndarray, (m,)
        Squared Mahalanobis distance of each from what the kept ones predict.
    limit : ndarray, (m,)
        The distance up to which each is believed.
    poses : ndarray, (n, 3) or (n, 7)
        Poses of all nodes near the minimum of the kept ones.
    """

    kept: Flags
    distance: Floats
    limit: Floats
    poses: Floats


def judge(
    assembly: Assembly,
    doubtful: Flags,
    initialize: Callable[[PoseGraph], PoseGraph],
    *,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Judgement:
    """Decide which doubtful measurements to believe in a map whose other edges are trusted.

    The map of the trusted edges is moved onto all that is known of it, robustly against a third of
    wrong fixes (`alignment.rigid_motion`); what lies far off there is left out of the first map.
    Then each measurement is compared with what the others predict, the worse half of the outlying
    ones is left out, and those return that the map predicts, until nothing changes. The limit of
    each kind is the distance that one honest measurement in 100,000 exceeds. It is wider where a
    quarter of a kind shows that its information is too large.

    Parameters
    ----------
    assembly : Assembly
        The graph.
    doubtful : ndarray of bool, (m,)
        The measurements of the assembled graph to judge.
    initialize : callable
        From the graph of all full edges to one with poses.
    threads : int, optional
        Threads that compute.
    progress : Progress, optional
        What limits the time.

    Returns
    -------
    Judgement
    """
    progress = progress or Progress()
    seen = assembly.source.landmarks
    if seen is None or seen.range_bearing is None:
        placed = placed_assembly(assembly, initialize)[0]
    else:
        placed, _ = guess_of_assembly(assembly, "chordal", threads=threads)
    graph = placed.graph
    judged = np.zeros(len(graph.edges), np.bool_)
    judged[: len(doubtful)] = doubtful
    ranks, kinds = _ranks_and_kinds(placed, judged)
    gate = np.array([np.inf, *FAR_GATE.values()])[ranks]
    assert graph.poses is not None
    distance = chi2_per_edge(graph, graph.poses)
    limit = gate * _scales(distance, ranks, kinds)
    kept = ~judged | (distance <= limit)
    returns = np.zeros(len(kept), np.int64)
    for _ in range(_MAX_ROUNDS):
        graph, distance = _compared(graph, kept, threads, progress)
        limit = gate * _scales(distance, ranks, kinds)
        outlying = np.flatnonzero(kept & judged & (distance > limit))
        back = ~kept & (distance <= limit) & (returns < _MAX_RETURNS)
        if progress.over or (len(outlying) == 0 and not back.any()):
            break
        if len(outlying):
            kept[_worst(outlying, distance / limit, graph.edge_indices[outlying, 1])] = False
        else:
            returns[back] += 1
            kept |= back
    assert graph.poses is not None
    measured = slice(0, placed.measured)
    return Judgement(kept[measured], distance[measured], limit[measured], graph.poses)


def _compared(
    graph: AssembledGraph, kept: Flags, threads: int | None, progress: Progress
) -> tuple[AssembledGraph, Floats]:
    """Return the map of kept measurements, and the distances of all from what others predict."""
    weights = np.where(kept, 1.0, _ABSENT)[:, None, None]
    present = replace(graph, information=graph.information * weights)
    equations = normal_equations(present, threads)
    poses = optimize(
        present,
        "dogleg",
        max_iterations=_ITERATIONS,
        relative_tolerance=_TOLERANCE,
        equations=equations,
        progress=progress,
    ).poses
    graph = replace(graph, poses=poses)
    compared = whitened(graph, equations, absent=~kept)
    chi2 = np.square(compared.residuals).sum(axis=1)
    return graph, np.maximum(compared.distances(), np.where(kept, chi2, 0.0))


def _worst(outlying: Ids, badness: Floats, nodes: Ids) -> Ids:
    """Return the worse half of the outlying measurements, and of each node at most the worse half.

    One that is far off makes the honest ones of its landmark outlying, too.
    """
    order = np.argsort(-badness[outlying], kind="stable")
    worse = order[: (len(order) + 1) // 2]
    by_node = order[np.argsort(nodes[order], kind="stable")]
    _, start, inverse, count = np.unique(
        nodes[by_node], return_index=True, return_inverse=True, return_counts=True
    )
    within = np.arange(len(by_node)) - start[inverse] < (count[inverse] + 1) // 2
    return outlying[np.intersect1d(worse, by_node[within])]


def _ranks_and_kinds(assembly: Assembly, judged: Flags) -> tuple[Ids, Ids]:
    """Return in how many directions each edge is measured, and a number for each kind of edge."""
    graph = assembly.graph
    values = np.linalg.eigvalsh(graph.information)
    ranks = (values > _NO_INFORMATION * values[:, -1:]).sum(axis=1)
    kinds = np.zeros(len(ranks), np.int64)
    for k, rows in enumerate((assembly.prior_rows, assembly.observation_rows), start=1):
        kinds[rows] = k
    return ranks, np.where(judged, kinds * (graph.dof + 1) + ranks, -1)


def _scales(distance: Floats, ranks: Ids, kinds: Ids) -> Floats:
    """Return by which factor a quarter of the measurements of each kind exceed what is expected."""
    out = np.ones(len(distance))
    for kind in np.unique(kinds):
        own = kinds == kind
        if np.count_nonzero(own) < _MIN_FOR_SCALE:
            continue
        expected = QUARTER[max(1, int(ranks[own][0]))]
        out[own] = max(1.0, float(np.quantile(distance[own], 0.25)) / expected)
    return out
