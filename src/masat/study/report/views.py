"""Interactive pages of some graphs of a study: what the methods make of them."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

from masat.errors import MasatError
from masat.graph import PoseGraph
from masat.optimizers import Result
from masat.solver import solve as robust_solve
from masat.study.closure_trial import ClosureTrial, spoiled
from masat.study.design import Design
from masat.study.names import Case
from masat.study.report.document import Block, Embedded, Heading, Paragraph
from masat.study.report.glossary import spoken
from masat.study.trial import Trial, initial_guess, instance, solve
from masat.viewing import view

# Each page takes about a megabyte of the report.
_MOST_VIEWS = 12


def init_views(design: Design, trials: list[Trial], folder: Path) -> Iterable[Block]:
    """Solve one instance of each world and graph again, and write a page that shows all maps.

    The instance is the first one, from the highest noise level down, that some initial guesses
    solve and others do not; or else the first one of the highest level.
    """
    chosen = _by_world(trials, _divides)
    yield from _section(
        chosen,
        "One instance of each world, solved again from each initial guess: the slider of a page "
        "goes through the maps, of which the last one has the lowest chi2.",
    )
    for case in chosen:
        maps = _solved(case, design)
        if maps:
            best = min(maps, key=lambda init: maps[init].chi2)
            before = {spoken(init): r.graph for init, r in maps.items() if init != best}
            title = f"{case.name}, best from {spoken(best)}"
            yield _written(case, maps[best], before, title, folder)


def closure_views(design: Design, trials: list[ClosureTrial], folder: Path) -> Iterable[Block]:
    """Solve one spoiled instance of each graph again, and write a page with what was rejected.

    The instance is the first one of the largest fraction of false loop closures.
    """
    chosen = _by_world(trials, lambda own: False)
    yield from _section(
        chosen,
        "One instance of each graph with the largest fraction of false loop closures, solved with "
        "robust=True: a page shows the rejected loop closures, dashed, and the clean map as truth.",
    )
    for case in chosen:
        what = spoiled(case, design.max_iterations)
        result = robust_solve(what.graph, robust=True, max_iterations=design.max_iterations)
        false = int(what.is_false.sum())
        title = f"{case.name}, {false} false loop closures"
        yield _written(
            case, result, {"false and true edges": what.graph}, title, folder, truth=what.clean
        )


def _by_world(trials: list[Trial] | list[ClosureTrial], telling: object) -> list[Case]:
    """Return a case of each world, at most as many as a report should hold."""
    of_world: dict[str, dict[Case, list[Trial | ClosureTrial]]] = {}
    for trial in trials:
        of_world.setdefault(trial.case.world, {}).setdefault(trial.case, []).append(trial)
    chosen = []
    for cases in of_world.values():
        # From the hardest level down, and within it in the order of the instances.
        ordered = sorted(cases, key=lambda c: (-max(c.sigma, default=0), -c.fraction, c.instance))
        assert callable(telling)
        chosen.append(next((c for c in ordered if telling(cases[c])), ordered[0]))
    return chosen[:_MOST_VIEWS]


def _divides(trials: list[Trial]) -> bool:
    """Whether some initial guesses solve a case and others do not."""
    return len({trial.succeeded for trial in trials}) > 1


def _section(chosen: list[Case], text: str) -> Iterable[Block]:
    if chosen:
        yield Heading("Maps")
        yield Paragraph(text)


def _solved(case: Case, design: Design) -> dict[str, Result]:
    graph, maps = instance(case), {}
    for init in design.inits:
        try:
            maps[init] = solve(initial_guess(graph, init), design.max_iterations)
        except MasatError:  # an initial guess that cannot do this graph, such as lago in 3D
            continue
    return maps


def _written(
    case: Case,
    shown: Result,
    before: dict[str, PoseGraph],
    title: str,
    folder: Path,
    truth: PoseGraph | None = None,
) -> Embedded:
    path = folder / f"map_{re.sub(r'[^A-Za-z0-9]+', '_', case.name).strip('_')}.html"
    view(shown, path, before=before, truth=truth, title=title)
    return Embedded(path, title)
