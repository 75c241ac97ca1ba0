"""`masat study`."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from masat.cli import EXIT_NOT_CONVERGED, show
from masat.cli.cluster import connect
from masat.study import (
    ClosureTrial,
    Store,
    StudyError,
    Trial,
    load_design,
    parse_run,
    run_case,
    run_study,
)
from masat.study.cases import AnyTrial
from masat.study.cluster import on_cluster
from masat.study.design import INITS, Design
from masat.study.design_file import shipped, shipped_text
from masat.study.robust_methods import METHODS
from masat.study.worlds import GROUND_TRUTH

_MAX_WORKERS = 1024


@click.group()
def study() -> None:
    """Run the MASAT paper's evaluation, or a study of your own, and report it.

    A study solves many noisy instances of simulated worlds, and real graphs, from several initial
    guesses, and compares these; or it adds false loop closures to them and compares robust methods.
    docs/studies.md in the repository is its manual.
    """


@study.command(epilog="Example:  masat study run quick --store results")
@click.argument("design")
@click.option(
    "--store", type=click.Path(path_type=Path), help="Folder of the results; made if needed."
)
@click.option(
    "--workers",
    type=click.IntRange(min=1, max=_MAX_WORKERS),
    default=min(os.cpu_count() or 1, _MAX_WORKERS),
    show_default="all cores",
    help="Number of threads on this machine.",
)
@click.option("--scheduler", help="Dask scheduler to run on instead, such as tcp://host:8786.")
@click.option(
    "--only",
    metavar="RUN",
    help="Run WORLD/SIGMAS/INSTANCE/INIT (or WORLD/SIGMAS/KIND:FRACTION/INSTANCE/METHOD) alone and "
    "print its result.",
)
@click.option("--retry", is_flag=True, help="Run the failed runs again.")
@click.option("-q", "--quiet", is_flag=True, help="Print only errors.")
def run(
    design: str,
    store: Path | None,
    workers: int,
    scheduler: str | None,
    only: str | None,
    retry: bool,
    quiet: bool,
) -> None:
    """Run DESIGN: the name of a design that comes with masat, or a TOML file with these keys.

    \b
    worlds          simulated worlds, such as "manhattan:1000:1550" (NAME:NODES:EDGES)
    sigmas          noise levels: [x, y, theta] in 2D, [translation, rotation] or six in 3D
    instances       number of noisy instances of each world at each level
    inits           initial guesses, and "ground_truth"
    max_iterations  limit of the Gauss-Newton iterations (default: 50)
    graphs          public graphs, or paths of files, solved once from each initial guess
    kinds           kinds of false loop closures, added to all graphs: a study of methods, not inits
    fractions       fractions of the false among all loop closures
    methods         methods against false loop closures, such as "robust"
    title           title of the report (default: the name of the file)

    `masat study design NAME` prints a design to start from; docs/studies.md in the repository
    describes the keys. A study that was stopped continues when the same command is run again. With
    --only, one run is repeated by its name, such as City10k/.35,.35,.35/17/masat.
    """  # noqa: D301
    plan = load_design(design)
    if only is not None:
        _run_one(plan, only)
        return
    if store is None:
        raise click.UsageError("name a folder for the results with --store")
    with ExitStack() as stack:
        results = stack.enter_context(Store(store, plan))
        if retry:
            results.forget_failed()
        executor, run_one = _engine(workers, scheduler)
        stack.enter_context(executor)
        total = plan.runs()
        bar = stack.enter_context(_Bar(total, quiet=quiet))
        try:
            run_study(results, executor, progress=bar.advance, run=run_one)
        except BaseException:
            # Cases that have not begun are dropped; those that are running are lost. Both run
            # again the next time.
            executor.shutdown(wait=False, cancel_futures=True)
            raise
    if not quiet:
        _tell_status(store)
        click.echo(f"Next: masat study report {store} -o REPORT")


@study.command()
@click.argument("folder", type=click.Path(path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def status(folder: Path, as_json: bool) -> None:
    """Print how many runs of the study in FOLDER are done."""
    _tell_status(folder, as_json=as_json)


@study.command()
@click.argument("folder", type=click.Path(path_type=Path))
@click.option(
    "-o",
    "--output",
    "out",
    required=True,
    type=click.Path(path_type=Path),
    help="Folder of the report; made if needed.",
)
@click.option("--latex", is_flag=True, help="Write the tables for LaTeX, too (.tex).")
@click.option(
    "--views",
    is_flag=True,
    help="Solve one instance of each world again, and embed its interactive map in the report.",
)
@click.option("-q", "--quiet", is_flag=True, help="Print only errors.")
def report(folder: Path, out: Path, latex: bool, views: bool, quiet: bool) -> None:
    """Write the report of the study in FOLDER, finished or not: tables, tests and figures.

    Figures are written as SVG, or PNG where they show maps, and as PDF for a paper.
    """
    from masat.study.report import build_report

    with Store(folder) as store:
        made = build_report(store, out, latex=latex, views=views)
    if not quiet:
        tables = len(made.tables)
        click.echo(f"written: {made.files[0]}, {made.files[1].name}, and {tables} tables")


@study.command()
@click.argument("name", required=False)
def design(name: str | None) -> None:
    """Print the design NAME that comes with masat, to start one of your own from.

    Without NAME, print the names.
    """
    click.echo("\n".join(shipped()) if name is None else shipped_text(name), nl=name is None)


def _run_one(plan: Design, name: str) -> None:
    case, column = parse_run(name)
    what, known = ("method", tuple(METHODS)) if case.kind else ("initial guess", INITS)
    if column not in known:
        raise StudyError(f"unknown {what} {column!r}; known: {', '.join(known)}")
    if column == GROUND_TRUTH and not case.sigma:
        raise StudyError(f"{name}: a real graph has no ground truth")
    (trial,) = run_case(case, (column,), plan.max_iterations)
    if trial.error:
        raise StudyError(f"{name}: {trial.error}")
    about = {"run": name, "seed": case.seed, "success": trial.succeeded}
    show.as_json(about | (_of_init(trial) if isinstance(trial, Trial) else _of_method(trial)))
    if not trial.succeeded:
        click.get_current_context().exit(EXIT_NOT_CONVERGED)


def _of_init(trial: Trial) -> dict[str, Any]:
    k = trial.success()
    return {
        "iterations": k,
        "chi2": trial.chi2,
        "reduced_chi2": trial.reduced_chi2(-1 if k is None else k),
        "init_seconds": trial.init_seconds,
        "solve_seconds": trial.solve_seconds,
    }


def _of_method(trial: ClosureTrial) -> dict[str, Any]:
    assert trial.scores is not None
    return {
        "strict_success": trial.scores.strict_success,
        "precision": trial.scores.precision,
        "recall": trial.scores.recall,
        **asdict(trial.scores),
        "seconds": trial.seconds,
        "plain_seconds": trial.plain_seconds,
    }


def _engine(
    workers: int, scheduler: str | None
) -> tuple[Executor, Callable[..., Sequence[AnyTrial]]]:
    """Return threads, and the function that runs a case: in the thread, or on the cluster."""
    if scheduler is None:
        return ThreadPoolExecutor(workers), run_case
    client = connect(scheduler, StudyError)
    # Twice as many cases are submitted as run at a time, so that no worker of the cluster waits.
    waiting = 2 * max(1, sum(client.nthreads().values()))
    return ThreadPoolExecutor(waiting), on_cluster(client)


def _tell_status(folder: Path, *, as_json: bool = False) -> None:
    with Store(folder) as store:
        design = store.design
        trials = list(store.trials())
    failed = [t for t in trials if t.error]
    solved = sum(t.succeeded for t in trials)
    solved_as = "succeeded" if design.methods else "converged"
    about: dict[str, Any] = {
        "runs": design.runs(),
        "done": len(trials),
        solved_as: solved,
        "failed": len(failed),
        "first_failure": f"{failed[0].case.name}: {failed[0].error}" if failed else None,
    }
    if as_json:
        show.as_json(about)
        return
    click.echo(
        f"{folder}: {len(trials)} of {design.runs()} runs done, {solved} {solved_as}, "
        f"{len(failed)} failed" + (f" ({about['first_failure']})" if failed else "")
    )


class _Bar:
    """A progress bar with the time left, on a terminal."""

    def __init__(self, total: int, *, quiet: bool) -> None:
        self._total = total
        self._silent = quiet or not sys.stderr.isatty()

    def __enter__(self) -> _Bar:
        if not self._silent:
            from rich.console import Console
            from rich.progress import (
                BarColumn,
                MofNCompleteColumn,
                Progress,
                TextColumn,
                TimeRemainingColumn,
            )

            self._bar = Progress(
                TextColumn("runs"),
                BarColumn(),
                MofNCompleteColumn(),
                TextColumn("left"),
                TimeRemainingColumn(elapsed_when_finished=True),
                console=Console(stderr=True),
                speed_estimate_period=300,
            )
            self._task = self._bar.add_task("", total=self._total)
            self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        if not self._silent:
            self._bar.stop()

    def advance(self, runs: int) -> None:
        """Count runs that are finished."""
        if not self._silent:
            self._bar.advance(self._task, runs)
