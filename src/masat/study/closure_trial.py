"""Running a case with false loop closures: each method, and what came of it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from time import perf_counter
from typing import NamedTuple

from masat.arrays import Flags
from masat.errors import MasatError
from masat.graph import PoseGraph
from masat.structure import Structure
from masat.study.names import Case
from masat.study.robust_methods import METHODS, plain_map
from masat.study.scores import Scores, score
from masat.study.trial import instance, reason
from masat.worlds import add_false_closures, normalized


@dataclass(frozen=True)
class ClosureTrial:
    """A finished or failed run of a method on a graph with false loop closures.

    Attributes
    ----------
    case : Case
        The graph that was solved.
    method : str
        One of `masat.study.robust_methods.METHODS`.
    scores : Scores or None
        The map against the clean one; None if the run failed.
    seconds : float
        Wall time of the method.
    plain_seconds : float
        Wall time of a plain solve of the clean graph from `auto`.
    error : str
        Why the run failed; empty if it did not.
    """

    case: Case
    method: str
    scores: Scores | None
    seconds: float
    plain_seconds: float
    error: str = ""

    @property
    def column(self) -> str:
        """What is compared: the method."""
        return self.method

    @property
    def succeeded(self) -> bool:
        """Whether the truncated cost of the true edges is that of the clean map, within 5 %."""
        return self.scores is not None and self.scores.success


class Spoiled(NamedTuple):
    """A graph with false loop closures.

    Attributes
    ----------
    clean : PoseGraph
        The graph without them at its optimum, its information divided by the reduced chi2.
    graph : PoseGraph
        The graph with them, as a front end would give it: without poses, unless nodes are fixed.
    is_false : ndarray of bool, (m,)
        Which of its edges are false.
    plain_seconds : float
        Wall time of the plain solve that found the clean map.
    """

    clean: PoseGraph
    graph: PoseGraph
    is_false: Flags
    plain_seconds: float


def spoiled(case: Case, max_iterations: int) -> Spoiled:
    """Solve the clean graph of a case and add the false loop closures."""
    graph = unsolved(instance(case.clean))
    begin = perf_counter()
    result = plain_map(graph, max_iterations)
    seconds = perf_counter() - begin
    clean = normalized(replace(result.graph, notes=graph.notes))
    with_false, is_false = add_false_closures(clean, case.kind, case.fraction, seed=case.seed)
    return Spoiled(clean, unsolved(with_false), is_false, seconds)


def unsolved(graph: PoseGraph) -> PoseGraph:
    """Return a copy for which nothing was computed yet, without poses unless nodes are fixed."""
    seen = graph.landmarks
    return replace(
        graph,
        poses=graph.poses if len(graph.fixed) else None,
        landmarks=None if seen is None else replace(seen, positions=None),
        labels=None,
        structure=Structure(graph.ids, graph.edges, graph.fixed, graph.dof),
    )


def run_methods(case: Case, methods: tuple[str, ...], max_iterations: int) -> list[ClosureTrial]:
    """Run a case with each of the methods; a failure is a trial with its reason."""
    try:
        what = spoiled(case, max_iterations)
    except (MasatError, OSError, MemoryError) as error:
        return [ClosureTrial(case, method, None, 0.0, 0.0, reason(error)) for method in methods]
    return [_run(case, what, method, max_iterations) for method in methods]


def _run(case: Case, what: Spoiled, method: str, max_iterations: int) -> ClosureTrial:
    try:
        # What a method computes of a graph must not save time to the next one.
        graph = unsolved(what.graph)
        begin = perf_counter()
        kept, poses = METHODS[method](graph, max_iterations)
        seconds = perf_counter() - begin
        scores = score(what.clean, graph, what.is_false, kept, poses)
    except Exception as error:  # one failed run must not end the study
        return ClosureTrial(case, method, None, 0.0, what.plain_seconds, reason(error))
    return ClosureTrial(case, method, scores, seconds, what.plain_seconds)
