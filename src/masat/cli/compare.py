"""`masat compare`."""

from __future__ import annotations

from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple

import click

from masat.cli import options, show
from masat.cli.progress import Iterations, Stages
from masat.errors import MasatError
from masat.graph import PoseGraph
from masat.initializers import INITIALIZERS, guess_of
from masat.optimizers import Result, optimize
from masat.progress import Progress

# chi2 this much above the best, relatively, is another minimum.
_SAME = 1e-6


class Run(NamedTuple):
    """One initial guess and where it led."""

    init: str
    seconds: float
    guess: PoseGraph
    result: Result


def run(
    graph: PoseGraph, method: str, *, quiet: bool, **limits: Any
) -> tuple[list[Run], dict[str, str]]:
    """Solve a graph from every initial guess; also return why some cannot be made."""
    runs, failures = [], {}
    for init in INITIALIZERS:
        begin = perf_counter()
        try:
            with Stages(f"initial guess {init}", quiet=quiet) as stages:
                guess = guess_of(graph, init, progress=Progress(report=stages))
            seconds = perf_counter() - begin
            with Iterations(init, limits.get("max_iterations", 100), quiet=quiet) as watch:
                result = optimize(guess, method, report=watch, **limits)
        except MasatError as failure:
            failures[init] = str(failure)
            continue
        runs.append(Run(init, seconds, guess, result))
    if not runs:
        raise MasatError(f"no initial guess leads anywhere: {next(iter(failures.values()))}")
    return runs, failures


def show_runs(runs: list[Run], failures: dict[str, str]) -> None:
    """Print the table of the runs, and which failed."""
    best = min(r.result.chi2 for r in runs)
    show.table(
        (
            "initial guess",
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
    for init, reason in failures.items():
        click.echo(f"{init} fails: {reason}")


def runs_as_json(runs: list[Run]) -> list[dict[str, Any]]:
    """Return what JSON says of the runs."""
    return [{"init": r.init, "init_seconds": r.seconds, **show.summary(r.result)} for r in runs]


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
    threads: int | None,
    as_json: bool,
    quiet: bool,
) -> None:
    """Solve the pose graph in FILE from every initial guess: time, chi2, iterations."""
    options.check_outputs(file, picture)
    options.check_picture(picture)
    graph = options.load(file, file_format, indefinite, quiet)
    runs, failures = run(
        graph,
        optimizer,
        quiet=quiet,
        max_iterations=max_iterations,
        relative_tolerance=tolerance,
        threads=threads,
    )
    if picture is not None:
        from masat.plotting import plot

        plot({r.init: r.result.graph for r in runs}, picture)
    if as_json:
        show.as_json(
            {
                "file": str(file),
                "notes": list(graph.notes),
                "inits": runs_as_json(runs),
                "failed": failures,
            }
        )
    elif not quiet:
        show_runs(runs, failures)
