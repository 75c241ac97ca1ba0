"""What a pose graph is like, and what is odd about it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from masat.arrays import Floats, Ids
from masat.graph import PoseGraph
from masat.residuals import chi2_per_edge

_WIDE = 1e9


@dataclass(frozen=True)
class Diagnosis:
    """Figures about a graph; see `diagnose`.

    Attributes
    ----------
    dimension, nodes, edges : int
        Sizes.
    ids : tuple of int
        The smallest and the largest id.
    odometry_edges, loop_closures : int
        Edges between consecutive ids, and all others.
    chain_gaps : int
        Pairs of consecutive ids that no edge joins.
    repeated_pairs : int
        Pairs of nodes that more than one edge joins.
    components : tuple of int
        Number of nodes of each connected component, largest first.
    degree : tuple of float
        Least, median and largest number of edges at a node.
    fixed : tuple of int
        Ids of the fixed nodes.
    information : tuple of float
        Least and largest eigenvalue of all information matrices; (0, 0) without edges.
    condition : float
        Largest ratio of eigenvalues within one information matrix.
    chi2, reduced_chi2 : float or None
        At the graph's own poses; None without poses, or degrees of freedom.
    worst_edges : tuple of (int, int, float)
        The five edges (from, to, chi2) that fit the poses worst.
    odd : tuple of str
        What to look at before trusting a result.
    """

    dimension: int
    nodes: int
    edges: int
    ids: tuple[int, int]
    odometry_edges: int
    loop_closures: int
    chain_gaps: int
    repeated_pairs: int
    components: tuple[int, ...]
    degree: tuple[int, float, int]
    fixed: tuple[int, ...]
    information: tuple[float, float]
    condition: float
    chi2: float | None
    reduced_chi2: float | None
    worst_edges: tuple[tuple[int, int, float], ...]
    odd: tuple[str, ...]


def diagnose(graph: PoseGraph) -> Diagnosis:
    """Look a graph over: sizes, connectivity, information, fit of its own poses, oddities."""
    n, m = len(graph.ids), len(graph.edges)
    pairs = np.sort(graph.edge_indices.astype(np.int64), axis=1)
    keys = pairs[:, 0] * n + pairs[:, 1]
    consecutive = pairs[:, 1] - pairs[:, 0] == 1
    chained = len(np.unique(keys[consecutive]))
    _, multiplicity = np.unique(keys, return_counts=True)
    sizes = np.sort(np.bincount(graph.components))[::-1]
    degree = np.bincount(pairs.ravel(), minlength=n)
    spectrum = np.linalg.eigvalsh(graph.information).astype(np.float64)
    cost = chi2_per_edge(graph) if graph.poses is not None else None
    free = n - len(graph.gauge)
    dof = graph.dof * (m - free)
    worst: list[tuple[int, int, float]] = []
    if cost is not None:
        places = np.argsort(-cost, kind="stable")[:5]
        worst = [(int(graph.edges[k, 0]), int(graph.edges[k, 1]), float(cost[k])) for k in places]
    return Diagnosis(
        dimension=graph.dimension,
        nodes=n,
        edges=m,
        ids=(int(graph.ids[0]), int(graph.ids[-1])),
        odometry_edges=int(consecutive.sum()),
        loop_closures=int(m - consecutive.sum()),
        chain_gaps=n - 1 - chained,
        repeated_pairs=int((multiplicity > 1).sum()),
        components=tuple(sizes.tolist()),
        degree=(int(degree.min()), float(np.median(degree)), int(degree.max())),
        fixed=tuple(graph.fixed.tolist()),
        information=(float(spectrum.min()), float(spectrum.max())) if m else (0.0, 0.0),
        condition=float((spectrum[:, -1] / spectrum[:, 0]).max()) if m else 1.0,
        chi2=None if cost is None else float(cost.sum()),
        reduced_chi2=None if cost is None or dof <= 0 else float(cost.sum()) / dof,
        worst_edges=tuple(worst),
        odd=(*graph.notes, *_oddities(graph, sizes.tolist(), degree, spectrum, chained)),
    )


def has_placeholder_poses(graph: PoseGraph) -> bool:
    """Whether all nodes that are not fixed have the same pose, as in files without a guess."""
    if graph.poses is None:
        return False
    free = graph.poses[~np.isin(graph.ids, graph.fixed)]
    return len(free) > 1 and bool((free == free[0]).all())


def _oddities(
    graph: PoseGraph,
    sizes: list[int],
    degree: Ids,
    spectrum: Floats,
    chained: int,
) -> list[str]:
    n, m = len(graph.ids), len(graph.edges)
    odd = []
    if len(sizes) > 1:
        alone = int((degree == 0).sum())
        odd.append(
            f"{len(sizes)} components with nothing measured between them"
            + (f", {alone} of them single nodes without an edge" if alone else "")
        )
    if m == n - len(sizes):
        odd.append("no loop is closed: every guess along the edges fits exactly")
    if chained < n - 1:
        pairs = np.sort(graph.edge_indices, axis=1)
        present = pairs[pairs[:, 1] - pairs[:, 0] == 1, 0]
        k = np.setdiff1d(np.arange(n - 1), present)[0]
        odd.append(
            f"the odometry chain is broken {n - 1 - chained} times, first between "
            f"{graph.ids[k]} and {graph.ids[k + 1]}"
        )
    if m and (spectrum[:, -1] > _WIDE * spectrum[:, 0]).any():
        k = int((spectrum[:, -1] / spectrum[:, 0]).argmax())
        odd.append(
            f"the information of edge {graph.edges[k, 0]} -> {graph.edges[k, 1]} spans "
            f"{spectrum[k, 0]:.3g} to {spectrum[k, -1]:.3g}: nearly singular"
        )
    if graph.poses is not None and n > 1 and (graph.poses == graph.poses[0]).all():
        odd.append("all poses are the same: placeholders, not a guess")
    if len(graph.fixed) == n:
        odd.append("every node is fixed: nothing can move")
    return odd
