"""The edges of a view: what was measured, how well the map fits, what was decided and why."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from masat.arrays import AnyArray, Flags, Floats, Ids
from masat.chain import odometry_edges
from masat.errors import GraphError
from masat.graph import PoseGraph
from masat.residuals import chi2_per_edge, residuals
from masat.viewing.payload import single

if TYPE_CHECKING:
    from masat.optimizers import Result
    from masat.viewing.states import State

# The name of a robot or a sensor is of use as a color, a text of its own for each edge is not.
_MOST_LABELS = 64


class Edges:
    """The edges of the graph that was solved, in its order, rejected ones included.

    Parameters
    ----------
    graph : PoseGraph
        The graph of the result: the edges that were kept.
    result : Result, optional
        The result.
    given : iterable of PoseGraph
        Graphs, one of which may be the one that was solved. Without it, what rejected edges
        measured is not known.

    Attributes
    ----------
    graph : PoseGraph
        The graph that was solved, if it is among those given; else that of the result.
    kept : ndarray of bool, (m,)
        Which edges the map was made of.
    ends : ndarray of int64, (m, 2)
        Indices of the nodes that each edge joins.
    """

    def __init__(
        self, graph: PoseGraph, result: Result | None, given: Sequence[PoseGraph] = ()
    ) -> None:
        decision = None if result is None else result.decision
        self._result, self._decision = result, decision
        kept = np.ones(len(graph.edges), np.bool_) if decision is None else decision.kept
        self.kept: Flags = kept
        solved = next((g for g in given if _is_of(g, graph, kept)), None)
        # The graph whose edges are known, and their indices among all.
        self._known: Ids = np.flatnonzero(kept) if solved is None else np.arange(len(kept))
        self.graph = graph if solved is None else solved
        self.ends: Ids = np.zeros((len(kept), 2), np.int64)
        self.ends[self._known] = self.graph.edge_indices
        if decision is not None:
            self.ends[decision.closures["edge"]] = graph.index(
                np.column_stack([decision.closures["from"], decision.closures["to"]])
            )

    @property
    def is_odometry(self) -> Flags:
        """Which edges are odometry, (m,)."""
        out = np.zeros(len(self.kept), np.bool_)
        out[self._known] = odometry_edges(self.graph)
        return out

    def chi2(self, poses: Floats) -> Floats:
        """Return chi2 of each edge at some poses, (m,); NaN where it is not known."""
        return self._spread(chi2_per_edge(self.graph, poses))

    def arrays(self, states: Sequence[State]) -> tuple[dict[str, AnyArray], dict[str, Any]]:
        """Return the arrays of the payload, and what its header says of them."""
        chi2 = np.array([self.chi2(state.poses) for state in states])
        arrays: dict[str, AnyArray] = {
            "ends": self.ends.astype(np.int32),
            "is_odometry": self.is_odometry,
            "kept": self.kept,
            "chi2": single(chi2),
            "measurements": single(self._spread(self.graph.measurements)),
            "residuals": single(self._spread(residuals(self.graph, states[-1].poses))),
        }
        # Sums in double precision, of the edges that the map was made of.
        totals = [float(row[self.kept].sum()) for row in chi2]
        header: dict[str, Any] = {"chi2": [t if np.isfinite(t) else None for t in totals]}
        if self._result is not None and self._result.weights is not None:
            weights = np.zeros(len(self.kept))
            weights[self.kept] = self._result.weights
            arrays["weights"] = single(weights)
        self._add_decision(arrays, header)
        self._add_labels(arrays, header)
        return arrays, header

    def _add_decision(self, arrays: dict[str, AnyArray], header: dict[str, Any]) -> None:
        if self._decision is None:
            return
        table = self._decision.closures
        reasons, codes = np.unique(table["reason"], return_inverse=True)
        header["reasons"] = ["trusted", *reasons.tolist()]
        # Zero stands for the edges that were trusted.
        arrays["reason"] = np.zeros(len(self.kept), np.uint16)
        arrays["reason"][table["edge"]] = codes + 1
        for name in ("distance", "cluster"):
            arrays[name] = np.full(len(self.kept), np.nan, np.float32)
            arrays[name][table["edge"]] = table[name]

    def _add_labels(self, arrays: dict[str, AnyArray], header: dict[str, Any]) -> None:
        labels = self.graph.labels
        if labels is None:
            return
        names, codes = np.unique(labels, return_inverse=True)
        if 1 < len(names) <= _MOST_LABELS:
            header["labels"] = [str(name) for name in names.tolist()]
            arrays["label"] = np.zeros(len(self.kept), np.uint8)
            arrays["label"][self._known] = codes

    def _spread(self, values: Floats) -> Floats:
        """Return values of the known edges as a row for each edge, NaN for the others."""
        if len(values) == len(self.kept):
            return values
        out = np.full((len(self.kept), *values.shape[1:]), np.nan)
        out[self._known] = values
        return out


def check_fits(graph: PoseGraph, before: Mapping[str, PoseGraph], result: Result | None) -> None:
    """Refuse a graph without poses, and a result that belongs to no graph that is given."""
    if graph.poses is None:
        raise GraphError(
            "the graph has no poses to draw: solve it (masat view --solve), or give it some with "
            "masat.initialize"
        )
    if len(graph) == 0:
        raise GraphError("the graph has no nodes to draw")
    if result is None or result.decision is None or not before:
        return
    if not any(_is_of(other, graph, result.decision.kept) for other in before.values()):
        raise GraphError(
            f"the result was made of {len(result.decision.kept)} edges, and none of the graphs "
            "that are given as before has the same ones: give the graph that was solved"
        )


def _is_of(solved: PoseGraph, graph: PoseGraph, kept: Flags) -> bool:
    """Whether a graph is the one whose kept edges make another graph."""
    return (
        len(solved.edges) == len(kept)
        and np.array_equal(solved.ids, graph.ids)
        and np.array_equal(solved.edges[kept], graph.edges)
    )
