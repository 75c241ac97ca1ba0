"""`masat compare`."""

from __future__ import annotations

from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple

import click

from masat.cli import options, show
from masat.errors import InitializationError
from masat.graph import PoseGraph
from masat.initializers import INITIALIZERS, initialize
from masat.optimizers import Result, optimize

# chi2 this much above the best, relatively, is another minimum.
_SAME = 1e-6


class Run(NamedTuple):
    """One start and where it led."""

    init: str
    seconds: float
    guess: PoseGraph
    result: Result


def run(
    graph: PoseGraph, method: str, *, quiet: bool, **limits: Any
) -> tuple[list[Run], dict[str, str]]:
    """Solve a graph from every start; of those that refuse it, tell why."""
    runs, refusals = [], {}
    for init in INITIALIZERS:
        begin = perf_counter()
        try:
            with show.Wait(f"start {init}", quiet=quiet):
                guess = initialize(graph, init)
                seconds = perf_counter() - begin
        except InitializationError as refusal:
            refusals[init] = str(refusal)
            continue
        with show.Watch(init, limits.get("max_iterations", 100), quiet=quiet) as watch:
            runs.append(Run(init, seconds, guess, optimize(guess, method, report=watch, **limits)))
    return runs, refusals


def tell(runs: list[Run], refusals: dict[str, str]) -> None:
    """Print the table of the runs, and who refused."""
    best = min(r.result.chi2 for r in runs)
    show.table(
        (
            "start",
            "guess took",
            "initial chi2",
            "final chi2",
            "reduced",
            "iterations",
            "solve took",
            "end",
        ),
        [
            (
                r.init,
                show.duration(r.seconds),
                show.number(r.result.initial_chi2),
                show.number(r.result.chi2),
                show.number(r.result.reduced_chi2),
                str(r.result.iterations),
                show.duration(r.result.seconds),
                _end(r.result, best),
            )
            for r in runs
        ],
    )
    for init, reason in refusals.items():
        click.echo(f"{init} refuses: {reason}")


def _end(result: Result, best: float) -> str:
    if not result.converged:
        return result.reason.name.lower().replace("_", " ")
    return "best" if result.chi2 <= best * (1 + _SAME) else "local minimum"


@click.command(epilog="Example:  masat compare M3500.g2o --optimizer gn")
@options.graph_file
@click.option("--plot", "picture", type=click.Path(path_type=Path), help="Picture of all results.")
@options.optimizer
@options.output
def compare(
    file: Path,
    file_format: str | None,
    indefinite: str,
    picture: Path | None,
    optimizer: str,
    max_iterations: int,
    tolerance: float,
    threads: int,
    as_json: bool,
    quiet: bool,
) -> None:
    """Solve the pose graph in FILE from every start: time, chi2 before and after, iterations."""
    options.check_picture(picture)
    graph = options.load(file, file_format, indefinite, quiet)
    runs, refusals = run(
        graph,
        options.OPTIMIZER_NAMES[optimizer],
        quiet=quiet,
        max_iterations=max_iterations,
        relative_tolerance=tolerance,
        threads=threads,
    )
    if picture is not None:
        from masat.plotting import plot

        plot({f"{r.init}: chi2 {r.result.chi2:.4g}": r.result.graph for r in runs}, picture)
    if as_json:
        starts = [
            {"init": r.init, "init_seconds": r.seconds, **show.summary(r.result)} for r in runs
        ]
        notes = list(graph.notes)
        show.as_json({"file": str(file), "notes": notes, "starts": starts, "refused": refusals})
    elif not quiet:
        tell(runs, refusals)
