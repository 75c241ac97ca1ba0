"""From a graph or a result to what the page draws."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from numpy.typing import ArrayLike

from masat.arrays import AnyArray
from masat.graph import PoseGraph
from masat.optimizers import Result
from masat.viewing.edges import Edges, check_fits
from masat.viewing.nodes import center_of, node_arrays
from masat.viewing.others import landmark_arrays, prior_arrays, truth_arrays
from masat.viewing.states import states_of


def scene_of(
    shown: PoseGraph | Result,
    *,
    before: Mapping[str, PoseGraph],
    iterations: Iterable[ArrayLike],
    truth: PoseGraph | None,
    covariances: bool,
    title: str,
) -> tuple[dict[str, Any], dict[str, AnyArray]]:
    """Return the header and the arrays of the payload; parameters as of `masat.view`."""
    result = shown if isinstance(shown, Result) else None
    graph = shown.graph if isinstance(shown, Result) else shown
    check_fits(graph, before, result)
    states = states_of(graph, before, iterations)
    edges = Edges(graph, result, list(before.values()))
    center, radius = center_of(graph)
    # What a robust solve rejected of the priors is only in the graph that was solved.
    solved = edges.graph.with_poses(states[-1].poses)
    if solved.landmarks is not None and graph.points is not None:
        solved = solved.with_points(graph.points)
    arrays, said = node_arrays(graph, states, center, with_covariances=covariances)
    of_edges, said_of_edges = edges.arrays(states)
    true, said_of_truth = truth_arrays(graph, truth, center)
    arrays |= of_edges | true | prior_arrays(solved, result, center)
    arrays |= landmark_arrays(graph, center)
    header: dict[str, Any] = {
        "title": title,
        "dimension": graph.dimension,
        "center": center.tolist(),
        "radius": radius,
        "states": [state.title for state in states],
        "facts": _facts(graph, result),
        "notes": list(graph.notes),
    }
    return header | said | said_of_edges | said_of_truth, arrays


def _facts(graph: PoseGraph, result: Result | None) -> list[tuple[str, str]]:
    """Return names and texts for the table at the top of the page."""
    facts = [("graph", f"{graph.dimension}D, {len(graph):,} nodes")]
    if result is None:
        return facts
    iterations = f"{result.iterations} iteration{'' if result.iterations == 1 else 's'}"
    facts.append(("optimizer", f"{iterations}, {result.method}"))
    if result.reduced_chi2 is not None:
        facts.append(("reduced chi2", f"{result.reduced_chi2:.4g}"))
    if not result.converged:
        facts.append(("not converged", result.message))
    if result.certificate is not None:
        facts.append(("optimum", result.certificate.status))
    return facts
