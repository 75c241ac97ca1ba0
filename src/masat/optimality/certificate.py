"""Whether the poses of a graph are the global optimum."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal, TypeAlias

from masat import _core
from masat.assembly import AssembledGraph, assemble, needs_assembly, translated
from masat.determinacy import with_undetermined_kept
from masat.errors import InitializationError, OptimizationError
from masat.freedoms import undetermined
from masat.graph import PoseGraph
from masat.optimality.bounds import TIGHT, chi2_bound, lifted_bound
from masat.optimality.branching import branched_bound
from masat.optimality.search import lower_minimum
from masat.optimizers import Result, optimize
from masat.optimizers.equations import normal_equations, rounding_level
from masat.optimizers.termination import blur
from masat.outliers import Minimum, describe_outliers
from masat.progress import Progress

# Times the chi2 that the rounding of coordinates makes: chi2 below it is zero to rounding.
_ZERO = 100.0
# Steps of Gauss-Newton to where not even rounding lets chi2 fall.
_LAST_STEPS = 3
# chi2 of rounding, for each measured number, above which it is more than rounding.
_MAX_ROUNDING = 1e-12

Status: TypeAlias = Literal["optimal", "refuted", "undecided"]


@dataclass(frozen=True, eq=False, repr=False)
class Certificate:
    """What is known about how good the poses of a graph are.

    Attributes
    ----------
    status : "optimal", "refuted" or "undecided"
        Whether chi2 of the poses is proven to be the lowest of all, to within `gap`; or poses of
        lower chi2 are known; or neither.
    message : str
        What was found, in a sentence.
    chi2 : float
        chi2 of the poses.
    bound : float
        No poses have a lower chi2. Where chi2 is zero to rounding it is chi2 itself.
    optimum : float
        The lowest chi2 that is known.
    better : PoseGraph or None
        The graph at poses of lower chi2, if such were found.
    caveat : str or None
        Why the map may be wrong even if its chi2 is the lowest: edges contradict the others, or
        chi2 is far too large. None if nothing is suspicious.
    """

    status: Status
    message: str
    chi2: float
    bound: float
    optimum: float
    better: PoseGraph | None
    caveat: str | None = None

    @property
    def certified(self) -> bool:
        """Whether the poses are proven to be globally optimal: chi2 itself, to within `gap`."""
        return self.status == "optimal"

    @property
    def gap(self) -> float:
        """How far below chi2 of the poses the bound lies, as a fraction of it."""
        return (self.chi2 - self.bound) / self.chi2 if self.chi2 > self.bound else 0.0

    def __repr__(self) -> str:
        return f"Certificate({self.status}: chi2 {self.chi2:.6g}, bound {self.bound:.6g})"

    def _repr_html_(self) -> str:
        from masat.display import certificate_html

        return certificate_html(self)

    def to_dict(self) -> dict[str, Any]:
        """Return the figures without the better graph, as JSON and saved results hold them."""
        return {
            "status": self.status,
            "certified": self.certified,
            "message": self.message,
            "chi2": self.chi2,
            "bound": self.bound,
            "gap": self.gap,
            "optimum": self.optimum,
            "caveat": self.caveat,
        }


def certify(
    graph: PoseGraph,
    *,
    search: bool = True,
    seed: int = 0,
    threads: int | None = None,
    progress: Progress | None = None,
    equations: _core.NormalEquations | None = None,
) -> Certificate:
    """Tell whether the poses of a graph, from whatever program, are globally optimal.

    The proof is of chi2 itself, in 2D and 3D and for any information (`bounds.chi2_bound`). It
    takes one factorization at the minimum near the poses. Poses that lie above this minimum, or
    above another one that is found, are refuted.

    Parameters
    ----------
    graph : PoseGraph
        A graph with the poses in question.
    search : bool
        Whether to search for a lower minimum and for better bounds, at a higher rank and in 2D by
        branch and bound, where there is no proof: expensive.
    seed : int
        Seed of the random noise that is added when a rank is raised.
    threads : int, optional
        Threads that compute; see `masat.optimize`.
    progress : Progress, optional
        What reports the stages and limits the time.
    equations : NormalEquations, optional
        Those of the graph, to be used again.

    Returns
    -------
    Certificate

    Raises
    ------
    OptimizationError
        If the graph has no poses.
    """
    if graph.poses is None:
        raise OptimizationError("the graph has no poses: there is nothing to certify")
    progress = progress or Progress()
    if needs_assembly(graph):
        return _certify_assembly(graph, search, seed, threads, progress)
    initial = graph.chi2
    rounding = rounding_level(graph)
    # Where rounding itself makes a chi2 that matters, it excuses nothing.
    if rounding > _MAX_ROUNDING * graph.dof * max(len(graph.edges), 1):
        rounding = 0.0
    if initial <= _ZERO * rounding:
        return Certificate(
            "optimal", "globally optimal: chi2 is zero to rounding", initial, initial, initial, None
        )
    if equations is None:
        equations = normal_equations(graph, threads)
    try:
        return _certify(graph, initial, rounding, search, seed, progress, equations)
    except KeyboardInterrupt:
        progress.interrupt()
        reason = "interrupted"
    except (OptimizationError, InitializationError) as error:
        reason = str(error)
    return Certificate("undecided", f"not decided: {reason}", initial, 0.0, initial, None)


def _certify_assembly(
    graph: PoseGraph, search: bool, seed: int, threads: int | None, progress: Progress
) -> Certificate:
    """Certify a graph with priors, landmarks or partial edges."""
    if graph.landmarks is not None and graph.points is None:
        raise OptimizationError("the landmarks have no positions: there is nothing to certify")
    assert graph.poses is not None
    if graph.landmarks is not None and graph.landmarks.range_bearing is not None:
        return _without_bound(graph, threads, progress)
    # Fixes are often kilometers from the origin, where rounding hides what has to be proven.
    middle = graph.poses[:, : graph.dimension].mean(axis=0)
    assembly = assemble(translated(graph, -middle))
    if not all(freedom.exact for freedom in undetermined(assembly)):
        message = "not decided: chi2 hardly depends on directions that nothing determines"
        return Certificate("undecided", message, graph.chi2, 0.0, graph.chi2, None)
    complete = with_undetermined_kept(assembly)[0].graph
    found = certify(complete, search=search, seed=seed, threads=threads, progress=progress)
    better = None
    if found.better is not None and found.better.poses is not None:
        better = translated(assembly.disassembled(found.better.poses), middle)
    return replace(found, better=better)


def _without_bound(graph: PoseGraph, threads: int | None, progress: Progress) -> Certificate:
    """Refute the poses of a graph with ranges and bearings, or leave them undecided."""
    initial = graph.chi2
    best = optimize(graph, relative_tolerance=1e-12, threads=threads, progress=progress)
    if initial - best.chi2 > TIGHT / 2 * best.chi2:
        message = f"not optimal: a minimum has chi2 {best.chi2:.8g}, lower than {initial:.8g}"
        return Certificate("refuted", message, initial, 0.0, best.chi2, best.graph)
    message = (
        "not decided: there is no bound of chi2 with observations of range or bearing, whose "
        "residuals are not linear in the position; give them as positions to certify the map"
    )
    return Certificate("undecided", message, initial, 0.0, min(initial, best.chi2), None)


def _certify(
    graph: PoseGraph,
    initial: float,
    rounding: float,
    search: bool,
    seed: int,
    progress: Progress,
    equations: _core.NormalEquations,
) -> Certificate:
    def minimum(of: PoseGraph) -> Result:
        return optimize(of, relative_tolerance=1e-12, equations=equations, progress=progress)

    def same(chi2: float) -> float:
        """Return what differences of chi2 do not count: half a gap, or what rounding blurs."""
        return max(TIGHT / 2 * chi2, blur(chi2, rounding))

    def proven(result: Result) -> bool:
        return result.chi2 - bound <= same(result.chi2)

    progress.tell("certifying", initial)
    best = minimum(graph)
    first, bound, trouble = best.chi2, 0.0, ""
    try:
        bound = chi2_bound(best.graph, best.chi2)
        if isinstance(graph, AssembledGraph) and not proven(best) and not progress.over:
            best, bound = _nearer(best, bound, equations, progress)
        if search and not proven(best) and not progress.over:
            progress.tell("bounding chi2 at a higher rank", best.chi2)
            higher, rounded = lifted_bound(best.graph, best.chi2, seed=seed)
            bound = max(bound, higher)
            if rounded is not None and not progress.over:
                best = min(best, minimum(rounded), key=lambda result: result.chi2)
            if not proven(best) and not progress.over:
                found = lower_minimum(best.graph, seed=seed, progress=progress, equations=equations)
                best = min(best, found, key=lambda result: result.chi2)
            if best.chi2 < first:
                bound = max(bound, chi2_bound(best.graph, best.chi2))
            if graph.dimension == 2 and not proven(best) and not progress.over:
                progress.tell("branching on relative rotations", best.chi2)
                higher, lower = branched_bound(best.graph, best.chi2, seed=seed, progress=progress)
                bound = max(bound, higher)
                if lower is not None:
                    best = min(best, minimum(lower), key=lambda result: result.chi2)
                    bound = max(bound, chi2_bound(best.graph, best.chi2))
    except KeyboardInterrupt:
        progress.interrupt()
        trouble = " (interrupted)"
    except (OptimizationError, InitializationError) as error:
        trouble = f" ({error})"
    bound = min(bound, best.chi2)
    if initial - best.chi2 > same(best.chi2):
        which = "the same minimum" if first - best.chi2 <= same(best.chi2) else "another minimum"
        status: Status = "refuted"
        message = f"not optimal: {which} has chi2 {best.chi2:.8g}, lower than {initial:.8g}"
    elif proven(best):
        status = "optimal"
        gap = max((initial - bound) / initial, 0.0)
        message = (
            f"globally optimal: no poses have a chi2 that is lower by more than {gap:.1g} of it"
        )
    else:
        status = "undecided"
        message = (
            f"not decided: no lower minimum was found, and the proof shows only that no poses have "
            f"a chi2 below {bound:.6g}{trouble}"
        )
    better = best.graph if status == "refuted" else None
    known: Minimum = "global" if proven(best) else "any"
    caveat = next(iter(describe_outliers(best.graph, known)), None)
    if caveat is not None:
        message += "; the map may be wrong all the same, since edges contradict it"
    return Certificate(status, message, initial, bound, min(best.chi2, initial), better, caveat)


def _nearer(
    best: Result, bound: float, equations: _core.NormalEquations, progress: Progress
) -> tuple[Result, float]:
    """Return a minimum, and the bound there, after steps that change chi2 by rounding alone.

    Soft modes, as a map turns about its fixes, may still be off the minimum by more than the bound
    can bear when chi2 shows it no more.
    """
    steps = optimize(
        best.graph,
        "gauss_newton",
        relative_tolerance=0.0,
        max_iterations=_LAST_STEPS,
        equations=equations,
        progress=progress,
    )
    return steps, max(bound, chi2_bound(steps.graph, steps.chi2))
