"""`masat view`."""

from __future__ import annotations

import subprocess
import sys
import webbrowser
from pathlib import Path
from time import perf_counter
from typing import Any

import click

from masat.arrays import Floats
from masat.bridges.rerun import save_rerun
from masat.cli import EXIT_NOT_CONVERGED, options, show
from masat.cli.progress import Iterations, Stages
from masat.graph import PoseGraph
from masat.optimizers import Result
from masat.solver import solve
from masat.viewing import view as page_of


@click.command(
    epilog="Examples:  masat view map.g2o    masat view M3500.g2o --solve --init odometry    "
    "masat view graph.g2o result.npz",
)
@click.argument("files", nargs=-1, required=True, type=click.Path(path_type=Path))
@options.reading
@click.option(
    "-o",
    "--output",
    "out",
    type=click.Path(path_type=Path),
    help="The page.  [default: the name of the last FILE with .html (or .rrd), in this folder]",
)
@click.option(
    "--solve",
    "is_solved",
    is_flag=True,
    help="Solve the graph first: the slider then goes from before through all iterations.",
)
@click.option(
    "--robust",
    is_flag=True,
    help="Solve it, and decide first which loop closures to believe; the page shows which were "
    "rejected, and why.",
)
@options.initial_guess
@click.option(
    "--truth",
    type=click.Path(path_type=Path),
    help="Graph or trajectory with the true poses, to draw beside the map.",
)
@click.option(
    "--covariances", is_flag=True, help="Draw the 95 % ellipses of the positions; takes longer."
)
@click.option("--title", help="Title of the page.  [default: the name of the last FILE]")
@click.option(
    "--rerun",
    is_flag=True,
    help="Write a file for rerun's viewer (.rrd) instead of a page. Needs masat[rerun].",
)
@click.option("--open", "opens", is_flag=True, help="Open the page in the browser, or in rerun.")
@options.output
@click.pass_context
def view(
    ctx: click.Context,
    files: tuple[Path, ...],
    file_format: str | None,
    indefinite: str,
    out: Path | None,
    is_solved: bool,
    robust: bool,
    init: str,
    root: int | None,
    truth: Path | None,
    covariances: bool,
    title: str | None,
    rerun: bool,
    opens: bool,
    as_json: bool,
    quiet: bool,
) -> None:
    """Write an HTML page with the map in FILE, which any browser opens, also offline.

    Drag to move the map, turn the wheel to zoom. Point at nodes and edges to read their ids,
    measurement, residual and chi2, and click to pick them. Color by chi2, time, session or robust
    weight; fly to the worst edges; switch edges off and export the list for masat solve --without.
    Press ? in the page for all keys.

    The page shows the poses that FILE holds. Without any, or with --solve, the graph is solved.

    Several FILEs are maps of the same nodes: the slider goes through them, and the page shows the
    edges of the last one. After a robust solve, give the graph and then the saved result:

        masat solve graph.g2o --robust --save result.npz

        masat view graph.g2o result.npz
    """
    source, last = files[-1], len(files) - 1
    if rerun and covariances:
        raise click.UsageError("--rerun draws no ellipses: leave out --covariances")
    out = out or Path(f"{source.name.split('.')[0] or 'map'}{'.rrd' if rerun else '.html'}")
    for file in (*files, truth):
        options.check_outputs(file, out)
    loaded = [options.load_any(file, file_format, indefinite, quiet) for file in files]
    truth_graph = None if truth is None else options.load(truth, None, indefinite, quiet)
    shown = loaded[last]
    before = {
        _name(files, k): one.graph if isinstance(one, Result) else one
        for k, one in enumerate(loaded[:last])
    }
    graph = shown.graph if isinstance(shown, Result) else shown
    solves = is_solved or robust or graph.poses is None
    iterations: list[Floats] = []
    if solves:
        if not (is_solved or robust) and not quiet:
            options.notes([f"{source.name} has no poses, so the graph is solved"])
        before[f"poses of {source.name}"] = graph
        shown = _solved(graph, source.name, iterations, init, root, robust, quiet)
    begin = perf_counter()
    drawn: dict[str, Any] = {
        "before": before,
        "iterations": iterations,
        "truth": truth_graph,
        "title": title or source.name,
    }
    if rerun:
        size = save_rerun(shown, out, **drawn)
    else:
        size = len(page_of(shown, out, covariances=covariances, **drawn).html.encode())
    seconds = perf_counter() - begin
    if as_json:
        about: dict[str, Any] = {"files": [str(file) for file in files], "page": str(out)}
        show.as_json(about | {"bytes": size, "seconds": seconds})
    elif not quiet:
        how = f"open it with: rerun {out}" if rerun else "open it in a browser"
        click.echo(f"{out}  ({size / 1e6:.2g} MB, {show.duration(seconds)}): {how}")
    if opens:
        _open(out, rerun=rerun)
    if solves and isinstance(shown, Result) and not shown.converged:
        click.echo(f"masat: {source}: {shown.message}", err=True)
        ctx.exit(EXIT_NOT_CONVERGED)


def _open(out: Path, *, rerun: bool) -> None:
    if rerun:
        subprocess.Popen([sys.executable, "-m", "rerun", str(out)])
    else:
        webbrowser.open(out.resolve().as_uri())


def _solved(
    graph: PoseGraph,
    name: str,
    iterations: list[Floats],
    init: str,
    root: int | None,
    robust: bool,
    quiet: bool,
) -> Result:
    """Return the result of a solve, and add the poses at its iterations to a list."""
    stages = Stages(f"{name}  {init}", quiet=quiet)
    count = Iterations(name, 100, quiet=quiet)
    with stages, count:
        result = solve(
            graph,
            init=init,
            root=root,
            robust=robust,
            report=count,
            report_poses=iterations.append,
            report_stage=stages,
        )
    if not quiet:
        options.notes(result.graph.notes[len(graph.notes) :])
    return result


def _name(files: tuple[Path, ...], k: int) -> str:
    """Return the name of a file, with its folder where another has the same name."""
    names = [file.name for file in files]
    return files[k].name if names.count(files[k].name) == 1 else str(files[k])
