"""Initial guesses; a method is one file here and one line of `INITIALIZERS`."""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Protocol

from masat import _core
from masat.assembly import Assembly, assemble, needs_assembly
from masat.determinacy import with_undetermined_kept
from masat.errors import InitializationError, MasatWarning
from masat.freedoms import degrees_of_freedom
from masat.graph import PoseGraph
from masat.initializers.auto import auto
from masat.initializers.cauchy import cauchy
from masat.initializers.chordal import chordal
from masat.initializers.given import given
from masat.initializers.lago import lago
from masat.initializers.lifted import lifted
from masat.initializers.masat import masat
from masat.initializers.most_informed_first import most_informed_first
from masat.initializers.odometry import odometry
from masat.initializers.placing import given_assembly, placed_assembly
from masat.initializers.roots import notes_of_components
from masat.initializers.spanning_tree import spanning_tree
from masat.initializers.spectral import spectral
from masat.initializers.toro import toro
from masat.initializers.triangulation import as_positions, is_plausible, with_points
from masat.optimality.best import best_minimum
from masat.optimizers import optimize
from masat.optimizers.equations import normal_equations
from masat.outliers import Suspicion, describe_outliers
from masat.progress import Progress

# Operations of a factorization above which the search does not go on from a minimum of plausible
# chi2: with bearings much more exact than ranges, or less, the proof that it is the lowest fails.
_EXPENSIVE = 1e9
# The change of chi2 that is near enough to a minimum of the positions for a guess.
_TOLERANCE = 1e-4


class Initializer(Protocol):
    """Gives a graph its poses; the first line of its docstring describes it to users."""

    def __call__(self, graph: PoseGraph) -> PoseGraph:
        """Return the graph with poses, its gauge-fixed nodes at the identity."""


class SearchingInitializer(Protocol):
    """An initializer that may take long: it reports its stages and can be given a time limit."""

    def __call__(
        self,
        graph: PoseGraph,
        *,
        seed: int = 0,
        progress: Progress | None = None,
        equations: _core.NormalEquations | None = None,
    ) -> PoseGraph:
        """Return the graph with poses, its gauge-fixed nodes at the identity."""


SEARCHES: dict[str, SearchingInitializer] = {"auto": auto, "lifted": lifted}

INITIALIZERS: dict[str, Initializer] = {
    "auto": auto,
    "odometry": odometry,
    "spanning_tree": spanning_tree,
    "masat": masat,
    "most_informed_first": most_informed_first,
    "lago": lago,
    "chordal": chordal,
    "spectral": spectral,
    "toro": toro,
    "cauchy": cauchy,
    "lifted": lifted,
    "given": given,
}


def initialize(
    graph: PoseGraph,
    method: str = "auto",
    *,
    root: int | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> PoseGraph:
    """Give a graph an initial guess.

    Parameters
    ----------
    graph : PoseGraph
        The graph. Its own poses count only for fixed nodes, and for the method "given".
    method : str
        One of `masat.initializers.INITIALIZERS`.
    root : int, optional
        Id of the node placed at the identity, which optimizers then leave there. Default: the
        smallest of its component. A component with fixed nodes begins at these, one with priors is
        moved onto them: neither has a root.
    seed : int
        Seed of the random noise that "auto" and "lifted" add when they raise a rank.
    progress : Progress, optional
        What reports the stages of "auto" and "lifted" and limits their time.

    Returns
    -------
    PoseGraph
        The graph with poses, (n, 3) or (n, 7) in the order of `ids`. Its `notes` tell what was
        bridged or left open; each new one is also a `MasatWarning`.

    Raises
    ------
    InitializationError
        If the method is unknown or cannot do what is asked.
    GraphError
        If the root is not in the graph, or is not fixed in a component that has fixed nodes or
        priors.
    """
    rooted = graph if root is None else graph.with_root(root)
    guess = guess_of(rooted, method, seed=seed, progress=progress)
    for note in guess.notes:
        if note not in graph.notes:
            warnings.warn(note, MasatWarning, stacklevel=2)
    return guess


def guess_of(
    graph: PoseGraph,
    method: str,
    *,
    seed: int = 0,
    progress: Progress | None = None,
    equations: _core.NormalEquations | None = None,
) -> PoseGraph:
    """Do what `initialize` does, without its warnings and with equations to be used again."""
    if method not in INITIALIZERS:
        raise InitializationError(
            f"unknown initial guess {method!r}; known: {', '.join(INITIALIZERS)}"
        )
    if needs_assembly(graph):
        placed, _ = guess_of_assembly(assemble(graph), method, seed=seed, progress=progress)
        assert placed.graph.poses is not None
        return replace(placed.disassembled(placed.graph.poses), notes=placed.graph.notes)
    if method in SEARCHES:
        return SEARCHES[method](graph, seed=seed, progress=progress, equations=equations)
    return INITIALIZERS[method](graph)


def guess_of_assembly(
    assembly: Assembly,
    method: str,
    *,
    seed: int = 0,
    progress: Progress | None = None,
    threads: int | None = None,
) -> tuple[Assembly, _core.NormalEquations]:
    """Return an assembly with the poses of an initial guess, and its equations to be used again.

    The assembly is complete with what keeps the directions that nothing determines; the notes of
    its graph name them. Parameters as of `initialize` and `optimize`.
    """
    if method not in INITIALIZERS:
        raise InitializationError(
            f"unknown initial guess {method!r}; known: {', '.join(INITIALIZERS)}"
        )
    seen = assembly.source.landmarks
    if seen is not None and seen.range_bearing is not None:
        assembly, notes = _with_positions_found(assembly, method, seed, progress, threads)
        placed, kept = with_undetermined_kept(assembly)
        if any(isinstance(note, Suspicion) for note in notes):
            # What was said of the positions may not hold for the ranges and bearings.
            notes = [note for note in notes if not isinstance(note, Suspicion)]
            notes += describe_outliers(placed.graph)
        notes += notes_of_components(assembly.source) + kept
        return placed.with_notes(notes), normal_equations(placed.graph, threads)
    placed, notes, kept, equations = _placed(assembly, method, seed, progress, threads)
    if method != "given":
        notes = [*notes_of_components(assembly.source), *notes]
    return placed.with_notes([*notes, *kept]), equations


def _placed(
    assembly: Assembly,
    method: str,
    seed: int,
    progress: Progress | None,
    threads: int | None,
) -> tuple[Assembly, list[str], list[str], _core.NormalEquations]:
    """Return an assembly with poses, notes of the guess, what is not determined, and equations."""
    if method == "given":
        placed, kept = given_assembly(assembly)
        return placed, [], kept, normal_equations(placed.graph, threads)
    first = chordal if method in SEARCHES else INITIALIZERS[method]
    placed, notes, kept = placed_assembly(assembly, first)
    equations = normal_equations(placed.graph, threads)
    if method in SEARCHES:
        found = best_minimum(placed.graph, seed=seed, progress=progress, equations=equations)
        placed, notes = placed.at(found.poses), [*notes, *found.notes]
    return placed, notes, kept, equations


def _with_positions_found(
    assembly: Assembly,
    method: str,
    seed: int,
    progress: Progress | None,
    threads: int | None,
) -> tuple[Assembly, list[str]]:
    """Return an assembly with ranges and bearings with poses and points, and notes of the guess."""
    source = assembly.source
    if method == "given" and source.points is not None:
        return given_assembly(assembly)[0], []
    in_positions = source.with_priors(None).with_landmarks(as_positions(source))
    in_positions = in_positions.with_priors(source.priors)
    positions = assemble(in_positions)
    expensive = positions.graph.elimination.operations(source.dof) > _EXPENSIVE
    first = "chordal" if expensive and method in SEARCHES else method
    known, notes, _, equations = _placed(positions, first, seed, progress, threads)
    if first != method:
        fit = optimize(
            known.graph, relative_tolerance=_TOLERANCE, progress=progress, equations=equations
        )
        known = known.at(fit.poses)
        if not is_plausible(fit.chi2, degrees_of_freedom(in_positions)):
            found = best_minimum(known.graph, seed=seed, progress=progress, equations=equations)
            known, notes = known.at(found.poses), [*notes, *found.notes]
    assert known.graph.poses is not None
    guess, more = with_points(source, known.disassembled(known.graph.poses), progress)
    parts = int(in_positions.components.max()) - int(source.components.max())
    if parts > 0:
        notes.append(
            f"{parts + 1} parts of the graph are joined by bearings alone or ranges alone: how "
            "they lie to each other is arbitrary in the initial guess"
        )
    return assemble(guess), notes + more
