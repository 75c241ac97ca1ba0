"""Edges that contradict the rest of a map, and maps that cannot be right."""

from __future__ import annotations

from typing import Literal, TypeAlias

import numpy as np

from masat.arrays import Flags, Floats, Ids
from masat.assembly import AssembledGraph
from masat.chain import odometry_edges
from masat.errors import OptimizationError
from masat.graph import PoseGraph
from masat.neighbors import neighbor_scale
from masat.quantiles import FAR_GATE, MEDIAN
from masat.redundancy import whitened

# Gates by which an edge may contradict the others. In clean public graphs, and in the worlds of the
# paper solved well, none exceeds 4.4; one false loop closure exceeded 27 in all trials.
_FAR = 6.0
# Gates that some edge's chi2 must exceed before all are examined, which takes a factorization.
_DOUBTFUL = 1.5
# Directions in which the other edges lower an edge's variance by no more than this fraction are
# determined by the edge alone: its residual there is rounding.
_LEAST_REDUNDANCY = 0.01
# A reduced chi2 above the first number and this many times the scale of neighboring loop closures
# does not come from noise. Local minima of simulated worlds stay below 1.8 and 9 times, and clean
# public graphs below one of the two; graphs with one false loop closure in ten, at the information
# that fits the rest, exceed 38 and 380 times.
_MAX_REDUCED, _MAX_RATIO = 2.0, 100.0
# A reduced chi2 above the first number is suspicious whatever the neighbors, most of which may be
# false, and above the second where there are no neighbors to compare with. Clean public graphs have
# up to 19 and 5.8.
_MAX_REDUCED_ANYHOW, _MAX_REDUCED_ALONE = 100.0, 8.0

_REMEDY = "(robust=True, or --robust, decides which to believe)"


class Suspicion(str):
    """A sentence on why a map cannot be right, or on what contradicts it.

    Attributes
    ----------
    contradiction : str
        The sentence without the probable causes and what to do about them.
    """

    contradiction: str
    _causes: list[str]

    def __new__(cls, contradiction: str, causes: list[str]) -> Suspicion:
        """Make a sentence of what is contradicted and of the probable causes."""
        said = super().__new__(cls, f"{contradiction}; probably {', or '.join(causes)}")
        said.contradiction, said._causes = contradiction, causes
        return said

    def __reduce__(self) -> tuple[type[Suspicion], tuple[str, list[str]]]:
        """Return what pickle makes the sentence of again."""
        return Suspicion, (self.contradiction, self._causes)


def cannot_be_right(graph: PoseGraph, chi2: float, *, strictness: float = 1.0) -> bool:
    """Whether chi2 is far above what short cycles of loop closures and odometry show.

    In a local minimum of a graph without false edges chi2 is hardly above that of the best map,
    compared with what false loop closures do to it. So this tells which of the two it is.

    Parameters
    ----------
    graph : PoseGraph
        The graph; its poses do not count.
    chi2 : float
        Its chi2 near a minimum.
    strictness : float
        Factor on what counts as far; larger than 1 for chi2 that is still falling.

    Returns
    -------
    bool
        False where the graph has too few neighboring loop closures to tell.
    """
    reduced = _reduced(graph, chi2)
    if not reduced > strictness * _MAX_REDUCED:
        return False
    scale = _neighbor_scale(graph)
    return scale is not None and reduced > strictness * _MAX_RATIO * scale


def outlying_edges(graph: PoseGraph) -> Ids:
    """Return the indices of edges that contradict all others, loop closures first, the worst first.

    What counts is by how much chi2 would fall without the edge. An edge contradicts the others if
    that is beyond six gates; the gate is the chi2 that one honest measurement in 100,000 exceeds.
    Where the typical edge has more than its information promises, the limit rises as much, so that
    information that is too large by a common factor makes no edge suspicious.

    Parameters
    ----------
    graph : PoseGraph
        A graph with poses at a minimum.

    Returns
    -------
    ndarray of int64
    """
    if not _is_doubtful(graph):
        return np.empty(0, np.int64)
    gate = FAR_GATE[graph.dof]
    loss, is_checked = _chi2_without(graph)
    far = np.flatnonzero(loss > gate * _limit(graph, loss, is_checked))
    return _closures_first(graph, far, loss)


Minimum: TypeAlias = Literal["any", "searched", "global"]
"""What is known of a minimum: nothing, that a search ended there, or that none is lower."""


def describe_outliers(graph: PoseGraph, minimum: Minimum = "any") -> tuple[Suspicion, ...]:
    """Return a sentence on why a map cannot be right, with its worst edges, or nothing.

    Parameters
    ----------
    graph : PoseGraph
        A graph with poses at a minimum.
    minimum : {"any", "searched", "global"}
        What is known of the minimum. The causes that it rules out are not named.

    Returns
    -------
    tuple of Suspicion
        One sentence, or none if nothing is suspicious.
    """
    if len(graph.edges) == 0 or graph.poses is None:
        return ()
    chi2 = graph.chi2_per_edge
    reduced = _reduced(graph, float(chi2.sum()))
    is_wrong = cannot_be_right(graph, float(chi2.sum()))
    assembled = isinstance(graph, AssembledGraph)
    cause = "some measurements are wrong" if assembled else "some loop closures are false"
    causes = [f"{cause} {_REMEDY}"]
    if minimum == "any":
        causes.append("this is a local minimum (init='auto' searches for lower ones)")
    if is_wrong or _is_too_large(graph, reduced):
        # The whole map is bent: what it would be without one edge tells little and takes long.
        far = _closures_first(graph, np.flatnonzero(chi2 > _FAR * FAR_GATE[graph.dof]), chi2)
        said = f"the map cannot be right: its reduced chi2 is {reduced:.3g}"
        if len(far):
            said += f", and {_contradiction(graph, far, chi2)}"
        if not is_wrong:
            causes.append("the information is too large")
    else:
        far = outlying_edges(graph)
        if len(far) == 0:
            return ()
        said = _contradiction(graph, far, chi2)
        if minimum == "searched":
            causes.append("this is a local minimum")
    return (Suspicion(said, causes),)


def _contradiction(graph: PoseGraph, far: Ids, chi2: Floats) -> str:
    what = f"of {len(chi2)} edges"
    if isinstance(graph, AssembledGraph):
        what = "measurements"
    worst = ", ".join(f"{_name(graph, edge)} ({chi2[edge]:.3g})" for edge in far[:3])
    return (
        f"{len(far)} {what} contradict the map far beyond their information (chi2 of the worst: "
        f"{worst})"
    )


def _name(graph: PoseGraph, edge: int) -> str:
    a, b = graph.edges[edge]
    if isinstance(graph, AssembledGraph) and a == graph.ids[-1]:
        return f"the prior of {b}"
    return f"{a} -> {b}"


def _closures_first(graph: PoseGraph, edges: Ids, badness: Floats) -> Ids:
    """Return edges in the order in which to look at them: odometry last, the worst first."""
    return edges[np.lexsort((-badness[edges], odometry_edges(graph)[edges]))]


def _reduced(graph: PoseGraph, chi2: float) -> float:
    full = graph.dof * len(graph.edges)
    values = graph.values if isinstance(graph, AssembledGraph) else full
    return chi2 / max(values - graph.dof * (len(graph.ids) - len(graph.gauge)), 1)


def _neighbor_scale(graph: PoseGraph) -> float | None:
    """Return the scale of neighboring loop closures, which priors and landmarks are not."""
    if isinstance(graph, AssembledGraph):
        return None if graph.relative is None else neighbor_scale(graph.relative)
    return neighbor_scale(graph)


def _is_too_large(graph: PoseGraph, reduced: float) -> bool:
    """Whether a reduced chi2 is too large for a map that can be trusted, for whatever reason."""
    if reduced <= _MAX_REDUCED_ALONE:
        return False
    return reduced > _MAX_REDUCED_ANYHOW or _neighbor_scale(graph) is None


def _is_doubtful(graph: PoseGraph) -> bool:
    """Whether the edges are worth a closer look, which most maps are spared."""
    chi2 = graph.chi2_per_edge
    if len(chi2) == 0:
        return False
    scale = max(1.0, float(np.median(chi2)) / MEDIAN[graph.dof])
    return bool(chi2.max() > _DOUBTFUL * scale * FAR_GATE[graph.dof])


def _chi2_without(graph: PoseGraph) -> tuple[Floats, Flags]:
    """Return by how much chi2 falls without each edge, (m,), and which edges others check.

    It falls by the squared distance of the measurement from what the others predict (`redundancy`).
    """
    try:
        white, left = whitened(graph)
    except OptimizationError:
        return graph.chi2_per_edge, np.ones(len(graph.edges), np.bool_)
    redundancy, axes = np.linalg.eigh(left)
    e = (axes.swapaxes(-1, -2) @ white[..., None])[..., 0]
    checked = redundancy > _LEAST_REDUNDANCY
    loss: Floats = (checked * np.square(e) / np.where(checked, redundancy, 1.0)).sum(axis=1)
    is_checked: Flags = np.any(checked, axis=1)
    return loss, is_checked


def _limit(graph: PoseGraph, loss: Floats, is_checked: Flags) -> float:
    """Return how many gates an edge may contradict the others by."""
    chain = odometry_edges(graph)
    kinds = [loss[is_checked & kind] for kind in (chain, ~chain)]
    typical = max((float(np.median(own)) for own in kinds if len(own)), default=0.0)
    scale = typical / MEDIAN[graph.dof]
    return _FAR * max(1.0, scale)
