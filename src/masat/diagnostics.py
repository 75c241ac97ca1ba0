"""What a pose graph is like: sizes, connectivity, information, and the fit of its own poses."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from masat.arrays import Flags, Floats
from masat.freedoms import degrees_of_freedom as _degrees_of_freedom
from masat.graph import PoseGraph
from masat.information import partial
from masat.issues import chain_edges, duplicate_edges, find_issues, repeated_pairs
from masat.residuals import chi2_per_edge


@dataclass(frozen=True)
class Diagnosis:
    """What `diagnose` found out about a graph.

    Attributes
    ----------
    dimension : int
        2 or 3.
    nodes, edges : int
        Number of nodes and of edges.
    priors, landmarks, observations : int
        Number of priors, of landmarks, and of observations of landmarks.
    ids : tuple of int
        The smallest and the largest node id.
    odometry_edges : int
        Number of edges between consecutive ids. In a list of ids with gaps, neighbors in the list
        are consecutive, but not the last node of a session and the first of the next.
    loop_closures : int
        Number of all other edges.
    chain_gaps : int
        Number of pairs of consecutive ids that no edge joins.
    repeated_pairs : int
        Number of pairs of nodes that more than one edge joins, in whichever direction.
    duplicate_edges : int
        Number of edges that repeat an earlier edge: the same nodes in the same direction, and the
        same measurement.
    components : tuple of int
        Number of nodes of each connected component, largest first.
    degree : tuple of (int, float, int)
        Smallest, median and largest number of edges at a node.
    fixed : tuple of int
        Ids of the fixed nodes.
    information : tuple of float
        Smallest and largest eigenvalue of all information matrices; (0, 0) without edges.
    condition : float
        Largest ratio of the largest to the smallest eigenvalue of one information matrix, at most
        4.5e15, since double precision tells no more; 1 without edges. Edges that leave a direction
        unmeasured do not count.
    information_ratio : float or None
        Median information of the odometry edges divided by that of the loop closures, where the
        information of an edge is the geometric mean of its eigenvalues. Edges that leave a
        direction unmeasured do not count. None if either kind is missing.
    chi2 : float or None
        chi2 at the graph's own poses: the sum of e' W e over all edges, priors and observations.
        None without poses, or if landmarks have no positions.
    degrees_of_freedom : int
        Number of measured values minus the number of unknown ones.
    reduced_chi2 : float or None
        chi2 divided by the degrees of freedom; about 1 if the poses are optimal and the information
        is that of the noise. None without `chi2`, or if no degrees of freedom are left.
    worst_edges : tuple of (int, int, float)
        Up to five edges (from, to, chi2) with the largest chi2, largest first.
    issues : tuple of str
        The notes of the graph, and what to look at before a result is trusted. Each issue says what
        was found, and then what to do.
    """

    dimension: int
    nodes: int
    edges: int
    priors: int
    landmarks: int
    observations: int
    ids: tuple[int, int]
    odometry_edges: int
    loop_closures: int
    chain_gaps: int
    repeated_pairs: int
    duplicate_edges: int
    components: tuple[int, ...]
    degree: tuple[int, float, int]
    fixed: tuple[int, ...]
    information: tuple[float, float]
    condition: float
    information_ratio: float | None
    chi2: float | None
    degrees_of_freedom: int
    reduced_chi2: float | None
    worst_edges: tuple[tuple[int, int, float], ...]
    issues: tuple[str, ...]

    def _repr_html_(self) -> str:
        from masat.display import diagnosis_html

        return diagnosis_html(self)


def diagnose(graph: PoseGraph) -> Diagnosis:
    """Examine a graph: sizes, connectivity, information, fit of its own poses, and issues.

    Nothing is optimized and nothing is changed. Graphs without edges or without poses can be
    examined too.

    Parameters
    ----------
    graph : PoseGraph
        The graph as it was read, or as an optimizer left it.

    Returns
    -------
    Diagnosis
    """
    n, m = len(graph.ids), len(graph.edges)
    is_odometry = chain_edges(graph)
    odometry_edges = int(is_odometry.sum())
    degree = np.bincount(graph.edge_indices.ravel(), minlength=n)
    eigenvalues = np.linalg.eigvalsh(graph.information).astype(np.float64)
    per_edge = None if graph.poses is None else chi2_per_edge(graph)
    is_placed = graph.landmarks is None or graph.points is not None
    chi2 = graph.chi2 if per_edge is not None and is_placed else None
    is_full = np.ones(m, np.bool_)
    is_full[partial(graph.information)] = False
    degrees_of_freedom = _degrees_of_freedom(graph)
    diagnosis = Diagnosis(
        dimension=graph.dimension,
        nodes=n,
        edges=m,
        priors=0 if graph.priors is None else len(graph.priors),
        landmarks=len(graph.point_ids),
        observations=0 if graph.landmarks is None else len(graph.landmarks.observations),
        ids=(int(graph.ids[0]), int(graph.ids[-1])),
        odometry_edges=odometry_edges,
        loop_closures=m - odometry_edges,
        chain_gaps=n
        - 1
        - len(graph.structure.session_begins)
        - len(np.unique(graph.edge_indices[is_odometry].min(axis=1))),
        repeated_pairs=repeated_pairs(graph, without=np.empty(0, np.int64))[0],
        duplicate_edges=len(duplicate_edges(graph)),
        components=tuple(np.sort(np.bincount(graph.components))[::-1].tolist()),
        degree=(int(degree.min()), float(np.median(degree)), int(degree.max())),
        fixed=tuple(graph.fixed.tolist()),
        information=(float(eigenvalues.min()), float(eigenvalues.max())) if m else (0.0, 0.0),
        condition=_condition(eigenvalues[is_full]),
        information_ratio=_information_ratio(graph, is_odometry & is_full, ~is_odometry & is_full),
        chi2=chi2,
        degrees_of_freedom=degrees_of_freedom,
        reduced_chi2=None if chi2 is None or degrees_of_freedom <= 0 else chi2 / degrees_of_freedom,
        worst_edges=() if per_edge is None else _worst_edges(graph, per_edge),
        issues=(),
    )
    return replace(diagnosis, issues=(*graph.notes, *find_issues(graph, diagnosis)))


def _condition(eigenvalues: Floats) -> float:
    if len(eigenvalues) == 0:
        return 1.0
    high = eigenvalues[:, -1]
    # The smallest eigenvalue of a nearly singular matrix may come out as zero or below.
    return float((high / np.maximum(eigenvalues[:, 0], np.finfo(np.float64).eps * high)).max())


def _information_ratio(graph: PoseGraph, odometry: Flags, closures: Flags) -> float | None:
    if not odometry.any() or not closures.any():
        return None
    # By logarithms: a product of six eigenvalues may be out of range.
    log_means = [
        np.linalg.slogdet(graph.information[which]).logabsdet / graph.dof
        for which in (odometry, closures)
    ]
    return float(np.exp(np.median(log_means[0]) - np.median(log_means[1])))


def _worst_edges(graph: PoseGraph, chi2: Floats) -> tuple[tuple[int, int, float], ...]:
    worst = np.argsort(-chi2, kind="stable")[:5]
    return tuple((int(graph.edges[k, 0]), int(graph.edges[k, 1]), float(chi2[k])) for k in worst)
