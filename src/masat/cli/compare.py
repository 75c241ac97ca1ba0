"""`masat compare`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from masat.cli import options, show
from masat.cli.progress import Iterations, Stages
from masat.comparison import Comparison, comparison_of, run_from
from masat.errors import MasatError
from masat.graph import PoseGraph
from masat.initializers import INITIALIZERS


def run(graph: PoseGraph, method: str, *, quiet: bool, **limits: Any) -> Comparison:
    """Solve a graph from every initial guess, with progress on a terminal."""
    runs, failures = [], {}
    for init in INITIALIZERS:
        stages = Stages(f"initial guess {init}", quiet=quiet)
        watch = Iterations(init, limits.get("max_iterations", 100), quiet=quiet)
        try:
            with stages, watch:
                made = run_from(graph, init, method, report=watch, report_stage=stages, **limits)
        except MasatError as failure:
            failures[init] = str(failure)
            continue
        runs.append(made)
    return comparison_of(runs, failures)


def show_runs(found: Comparison) -> None:
    """Print the table of the runs, and which failed."""
    show.table(found.columns, found.rows)
    for init, reason in found.failures.items():
        click.echo(f"{init} fails: {reason}")


def runs_as_json(found: Comparison) -> list[dict[str, Any]]:
    """Return what JSON says of the runs."""
    return [
        {"init": r.init, "init_seconds": r.seconds, **show.summary(r.result)} for r in found.runs
    ]


@click.command(epilog="Example:  masat compare M3500.g2o --optimizer gn")
@options.graph_file
@click.option("--plot", "picture", type=click.Path(path_type=Path), help="Picture of all results.")
@click.option(
    "--view",
    "page",
    type=click.Path(path_type=Path),
    help="Interactive page (.html) whose slider goes through the maps, the best one last.",
)
@options.optimizer
@options.output
def compare(
    file: Path,
    file_format: str | None,
    indefinite: str,
    picture: Path | None,
    page: Path | None,
    optimizer: str,
    max_iterations: int,
    tolerance: float,
    threads: int | None,
    as_json: bool,
    quiet: bool,
) -> None:
    """Solve the pose graph in FILE from every initial guess: time, chi2, iterations."""
    options.check_outputs(file, picture, page)
    options.check_picture(picture)
    graph = options.load(file, file_format, indefinite, quiet)
    found = run(
        graph,
        optimizer,
        quiet=quiet,
        max_iterations=max_iterations,
        relative_tolerance=tolerance,
        threads=threads,
    )
    if picture is not None:
        from masat.plotting import plot

        plot({r.init: r.result.graph for r in found.runs}, picture)
    if page is not None:
        found.view(page, title=file.name)
    if as_json:
        show.as_json(
            {
                "file": str(file),
                "notes": list(graph.notes),
                "inits": runs_as_json(found),
                "failed": dict(found.failures),
            }
        )
    elif not quiet:
        show_runs(found)
