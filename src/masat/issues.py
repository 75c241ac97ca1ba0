"""What to look at in a graph before a result is trusted; an issue is one function here."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from masat.arrays import Flags, Ids
from masat.graph import PoseGraph
from masat.information import partial

if TYPE_CHECKING:
    from masat.diagnostics import Diagnosis

# Ratio of eigenvalues above which one direction of a measurement is as good as unmeasured. The
# public graphs reach 3e9 (parking-garage) and 2e11 (INTEL) with information that is too wide.
_MAX_CONDITION = 1e9
# Ratio of the information of odometry and loop closures, 100 between their standard deviations. The
# public graphs stay between 0.1 and 80.
_MAX_INFORMATION_RATIO = 1e4
# Reduced chi2 beyond this factor from 1 is an issue, if it is also this many of its standard
# deviations away, which are sqrt(2 / degrees of freedom).
_MAX_REDUCED_CHI2, _SIGNIFICANT = 10.0, 3.0


def find_issues(graph: PoseGraph, diagnosis: Diagnosis) -> list[str]:
    """Return the issues of a graph, given all other fields of its diagnosis.

    Each is a sentence that says what was found, and one that says what to do.
    """
    found = [check(graph, diagnosis) for check in _CHECKS]
    return [issue for issue in found if issue is not None]


def has_placeholder_poses(graph: PoseGraph) -> bool:
    """Whether all nodes that are not fixed have the same pose, as in files without a guess."""
    if graph.poses is None:
        return False
    free = graph.poses[~np.isin(graph.ids, graph.fixed)]
    return len(free) > 1 and bool((free == free[0]).all())


def duplicate_edges(graph: PoseGraph) -> Ids:
    """Return the indices of edges with the nodes and the measurement of an earlier edge."""
    _, inverse, count = np.unique(
        graph.edge_indices @ [len(graph.ids), 1], return_inverse=True, return_counts=True
    )
    repeated = np.flatnonzero(count[inverse] > 1)
    # Adding zero makes -0.0 and 0.0 the same.
    rows = np.column_stack([inverse[repeated], graph.measurements[repeated]]) + 0.0
    _, first = np.unique(rows, axis=0, return_index=True)
    return np.delete(repeated, first)


def chain_edges(graph: PoseGraph) -> Flags:
    """Return which edges, (m,), join consecutive nodes of one session."""
    low, high = np.sort(graph.edge_indices, axis=1).T
    chain: Flags = (high - low == 1) & ~np.isin(high, graph.structure.session_begins)
    return chain


def repeated_pairs(graph: PoseGraph, without: Ids) -> tuple[int, int]:
    """Return how many pairs of nodes more than one edge joins, and the first such edge.

    The edges with indices `without` do not count. The edge is 0 if there is no such pair.
    """
    pairs = np.sort(np.delete(graph.edge_indices, without, axis=0).astype(np.int64), axis=1)
    _, first, count = np.unique(pairs @ [len(graph.ids), 1], return_index=True, return_counts=True)
    many = first[count > 1]
    kept = np.delete(np.arange(len(graph.edges)), without)
    return len(many), int(kept[many.min()]) if len(many) else 0


def _no_edges(graph: PoseGraph, d: Diagnosis) -> str | None:
    if d.edges + d.priors + d.observations > 0:
        return None
    return "The graph has no edges, so there is nothing to optimize. Check the source of the graph."


def _components(graph: PoseGraph, d: Diagnosis) -> str | None:
    if len(d.components) == 1 or d.edges == 0:
        return None
    single = d.components.count(1)
    which = f", {single} of them single nodes without an edge" if single else ""
    return (
        f"The graph has {len(d.components)} components that no edge joins{which}. Each is "
        "optimized in a frame of its own; add edges between them if they belong to one map."
    )


def _no_cycle(graph: PoseGraph, d: Diagnosis) -> str | None:
    if d.degrees_of_freedom > 0 or d.edges == 0:
        return None
    if d.priors + d.observations:
        return (
            "Nothing is measured twice: the measurements are no more than the unknowns, so that no "
            "residual tells how good they are. Add loop closures, priors or observations."
        )
    return (
        "The graph has no cycle: poses chained along the edges fit every measurement exactly, and "
        "optimization cannot improve them. Add loop closures."
    )


def _chain(graph: PoseGraph, d: Diagnosis) -> str | None:
    if d.chain_gaps == 0 or d.edges == 0:
        return None
    if d.odometry_edges == 0:
        return (
            "There is no odometry: no edge joins nodes with consecutive ids. Use an initial guess "
            "other than 'odometry'."
        )
    first = np.delete(np.arange(d.nodes), graph.structure.session_begins - 1)[:-1]
    joined = graph.edge_indices[chain_edges(graph)].min(axis=1)
    k = int(np.setdiff1d(first, joined)[0])
    times = "once, between" if d.chain_gaps == 1 else f"{d.chain_gaps} times, first between"
    return (
        f"The odometry chain is broken {times} nodes {graph.ids[k]} and {graph.ids[k + 1]}, which "
        "no edge joins. Check whether measurements were lost, or use an initial guess other than "
        "'odometry'."
    )


def _parallel_edges(graph: PoseGraph, d: Diagnosis) -> str | None:
    if d.repeated_pairs == 0:
        return None
    count, k = repeated_pairs(graph, duplicate_edges(graph))
    if count == 0:
        return None
    a, b = graph.edges[k]
    what = (
        f"Nodes {a} and {b} are joined by more than one edge."
        if count == 1
        else f"{count} pairs of nodes are joined by more than one edge, first {a} and {b}."
    )
    return f"{what} Each edge counts as a measurement of its own; merge those of the same data."


def _duplicates(graph: PoseGraph, d: Diagnosis) -> str | None:
    if d.duplicate_edges == 0:
        return None
    a, b = graph.edges[duplicate_edges(graph)[0]]
    what = (
        f"Edge {a} -> {b} repeats an earlier edge with the same measurement."
        if d.duplicate_edges == 1
        else f"{d.duplicate_edges} edges repeat an earlier edge with the same measurement, first "
        f"{a} -> {b}."
    )
    return f"{what} Such a measurement counts twice; remove the copies."


def _singular_information(graph: PoseGraph, d: Diagnosis) -> str | None:
    if d.condition <= _MAX_CONDITION:
        return None
    eigenvalues = np.linalg.eigvalsh(graph.information)
    ratio = eigenvalues[:, 0] / eigenvalues[:, -1]
    ratio[partial(graph.information)] = np.inf
    k = int(ratio.argmin())
    return (
        f"The information of edge {graph.edges[k, 0]} -> {graph.edges[k, 1]} is nearly singular: "
        f"its eigenvalues span {eigenvalues[k, 0]:.3g} to {eigenvalues[k, -1]:.3g}. Check its "
        "units, and whether each direction was measured."
    )


def _information_scales(graph: PoseGraph, d: Diagnosis) -> str | None:
    ratio = d.information_ratio
    if ratio is None or 1 / _MAX_INFORMATION_RATIO <= ratio <= _MAX_INFORMATION_RATIO:
        return None
    more, less = ("odometry", "loop closures") if ratio > 1 else ("loop closures", "odometry")
    return (
        f"The information of the {more} is {max(ratio, 1 / ratio):.2g} times that of the {less} "
        "(medians). Check that both are inverse covariances in the same units."
    )


def _placeholders(graph: PoseGraph, d: Diagnosis) -> str | None:
    if not has_placeholder_poses(graph):
        return None
    return (
        "All poses of the nodes that are not fixed are the same: they are placeholders. Use an "
        "initial guess other than 'given'."
    )


def _nothing_free(graph: PoseGraph, d: Diagnosis) -> str | None:
    if len(d.fixed) < d.nodes or d.landmarks:
        return None
    return (
        "Every node is fixed, so optimization changes nothing. Fix only nodes whose poses are "
        "known better than the edges tell."
    )


def _fit(graph: PoseGraph, d: Diagnosis) -> str | None:
    reduced = d.reduced_chi2
    if reduced is None or has_placeholder_poses(graph):
        return None
    if abs(reduced - 1) <= _SIGNIFICANT * np.sqrt(2 / d.degrees_of_freedom):
        return None
    what = f"The reduced chi2 of the graph's own poses is {reduced:.3g}, far"
    if reduced > _MAX_REDUCED_CHI2:
        return (
            f"{what} above 1. Before optimization that is usual; after it, look for false loop "
            "closures (robust=True decides which to believe), for a lower minimum, and for "
            "information that is too large."
        )
    if reduced < 1 / _MAX_REDUCED_CHI2:
        return (
            f"{what} below 1. Either the information is too small for the noise, or the "
            "measurements were computed from these poses; covariances come out too large."
        )
    return None


_CHECKS = (
    _no_edges,
    _nothing_free,
    _components,
    _no_cycle,
    _chain,
    _parallel_edges,
    _duplicates,
    _singular_information,
    _information_scales,
    _placeholders,
    _fit,
)
