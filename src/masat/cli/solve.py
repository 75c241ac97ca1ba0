"""`masat solve`."""

from __future__ import annotations

from pathlib import Path
from time import perf_counter
from typing import Any

import click
from click.core import ParameterSource

from masat.cli import EXIT_NOT_CONVERGED, options, show
from masat.cli.decisions import rejected_part, rows_of_decision
from masat.cli.partition import solve_parts
from masat.cli.progress import Iterations, Stages
from masat.formats import format_of, read_edge_list, write
from masat.graph import PoseGraph
from masat.optimizers import Result
from masat.outliers import Suspicion
from masat.solver import solve as solved

# Options that only a folder of parts takes, and others that it takes too.
_OF_PARTS = ("scheduler", "memory", "restart")
_TAKEN_BY_PARTS = (
    "file",
    "out",
    "init",
    "loss",
    "loss_scale",
    "optimizer",
    "max_iterations",
    "tolerance",
    "threads",
    "as_json",
    "quiet",
)


@click.command(
    epilog="Example:  masat solve M3500.g2o -o map.g2o --plot map.png",
)
@options.graph_file
@click.option(
    "-o", "--output", "out", type=click.Path(path_type=Path), help="Map: .g2o, .tum or .kitti."
)
@click.option(
    "--plot", "picture", type=click.Path(path_type=Path), help="Picture, before and after."
)
@click.option(
    "--save", type=click.Path(path_type=Path), help="Result with its history, .npz (Result.load)."
)
@options.initial_guess
@options.search
@click.option(
    "--certify/--no-certify",
    default=None,
    help="Whether to prove that the map is the global optimum.  "
    "[default: unless --quiet or --loss]",
)
@click.option(
    "--robust",
    is_flag=True,
    help="Decide first which loop closures, priors and observations of landmarks to believe; the "
    "map is made of these alone.",
)
@click.option(
    "--rejected",
    type=click.Path(path_type=Path),
    help="Where to write the edges, priors and observations that --robust rejects, and nothing "
    "else, in g2o.",
)
@click.option(
    "--without",
    "left_out",
    type=click.Path(path_type=Path),
    help="List of edges to leave out, as the page of masat view exports it. A line is the index of "
    "an edge (from 0, in the order of FILE), the ids 'from to', or 'from to index'.",
)
@options.robust_loss
@options.optimizer
@click.option(
    "--scheduler",
    help="For a folder of parts: Dask scheduler to run on, such as tcp://host:8786.  "
    "[default: this process solves the parts one after the other]",
)
@click.option(
    "--memory",
    type=click.IntRange(min=0),
    metavar="BYTES",
    help="For a folder of parts without --scheduler: memory for their factors; what does not fit "
    "is computed again.  [default: a quarter of the machine's memory]",
)
@click.option(
    "--restart",
    is_flag=True,
    help="For a folder of parts: begin again, in the place of going on where a solve ended.",
)
@options.output
@click.pass_context
def solve(
    ctx: click.Context,
    file: Path,
    file_format: str | None,
    indefinite: str,
    out: Path | None,
    picture: Path | None,
    save: Path | None,
    init: str,
    root: int | None,
    seed: int,
    budget: float | None,
    certify: bool | None,
    robust: bool,
    rejected: Path | None,
    left_out: Path | None,
    loss: str | None,
    loss_scale: float | None,
    optimizer: str,
    max_iterations: int,
    tolerance: float,
    threads: int | None,
    scheduler: str | None,
    memory: int | None,
    restart: bool,
    as_json: bool,
    quiet: bool,
) -> None:
    """Optimize the pose graph in FILE: read, make an initial guess, optimize, write, draw.

    Nodes named by FIX keep their poses. In a component without any, and without priors such as
    position fixes, the smallest id is not optimized, or the node named with --root.

    Ctrl-C ends the search with the best map so far, which is still written.

    In the place of FILE stands a folder that masat partition made to solve it part by part. Its
    poses are written there after each iteration, and the same command goes on where it ended.
    """
    if file.is_dir():
        _refuse_options(ctx)
        solve_parts(
            ctx,
            file,
            out,
            init,
            loss,
            loss_scale,
            optimizer,
            max_iterations,
            tolerance,
            threads,
            scheduler,
            memory,
            restart,
            as_json,
            quiet,
        )
        return
    for name in _OF_PARTS:
        if _is_given(ctx, name):
            raise click.UsageError(f"--{name} goes with a folder that masat partition made")
    if rejected is not None and not robust:
        raise click.UsageError("--rejected goes with --robust")
    options.check_outputs(file, out, rejected, save, picture)
    options.check_outputs(left_out, out, rejected, save, picture)
    options.check_picture(picture)
    if out is not None:
        format_of(out)
    options.check_rejected(rejected)
    if certify is None:
        certify = loss is None and (as_json or not quiet)
    begin = perf_counter()
    graph = options.load(file, file_format, indefinite, quiet)
    read_seconds = perf_counter() - begin
    graph = _without(graph, left_out, quiet)
    options.check_stamps(graph, out)
    stages = Stages(f"{file.name}  {init}", quiet=quiet)
    iterations = Iterations(file.name, max_iterations, quiet=quiet)
    with stages, iterations:
        result = solved(
            graph,
            init=init,
            optimizer=optimizer,
            root=root,
            certify=certify,
            robust=robust,
            loss=loss,
            scale=loss_scale,
            max_iterations=max_iterations,
            relative_tolerance=tolerance,
            threads=threads,
            seed=seed,
            budget=budget,
            report=iterations,
            report_stage=stages,
        )
    if not quiet:
        notes = result.graph.notes[len(graph.notes) :]
        options.notes([n for n in notes if not (stages.has_warned and isinstance(n, Suspicion))])
    if out is not None:
        write(result.graph, out)
    if rejected is not None:
        write(rejected_part(graph, result), rejected)
    if save is not None:
        result.save(save)
    if picture is not None:
        from masat.plotting import before_and_after, plot

        plot(before_and_after(graph, result), picture)
    times = {
        "read": read_seconds,
        "initial guess": result.init_seconds,
        "optimize": result.seconds,
    }
    if as_json:
        about: dict[str, Any] = {
            "file": str(file),
            "nodes": len(graph),
            "edges": len(graph.edges),
            "init": init,
            "notes": list(result.graph.notes),
            "times": times,
        }
        proof = result.certificate and result.certificate.to_dict()
        decision = result.decision and result.decision.to_dict()
        show.as_json(about | show.summary(result) | {"certificate": proof, "decision": decision})
    elif not quiet:
        print_result(result, times, [p for p in (out, rejected, save, picture) if p is not None])
    if not result.converged:
        if quiet or as_json:
            click.echo(f"masat: {file}: {result.message}", err=True)
        ctx.exit(EXIT_NOT_CONVERGED)


def _is_given(ctx: click.Context, name: str) -> bool:
    return ctx.get_parameter_source(name) is ParameterSource.COMMANDLINE


def _refuse_options(ctx: click.Context) -> None:
    """Refuse the options that a folder of parts does not take."""
    for parameter in ctx.command.params:
        name = parameter.name or ""
        if _is_given(ctx, name) and name not in (*_TAKEN_BY_PARTS, *_OF_PARTS):
            raise click.UsageError(f"{parameter.opts[-1]} does not go with a folder of parts")


def _without(graph: PoseGraph, file: Path | None, quiet: bool) -> PoseGraph:
    """Return the graph without the edges that a list names, if there is a list."""
    if file is None:
        return graph
    edges = read_edge_list(file, graph)
    if not quiet:
        options.notes([f"{len(edges)} of {len(graph.edges)} edges are left out, by {file}"])
    return graph.without_edges(edges)


def print_result(result: Result, times: dict[str, float], written: list[Path]) -> None:
    """Print what a solve found, and where it is written."""
    graph = result.graph
    gauge = ", ".join(map(str, result.gauge[:5])) + (", ..." if len(result.gauge) > 5 else "")
    show.rows(
        [
            ("graph", f"{graph.dimension}D, {_sizes(graph)}"),
            ("initial guess", f"{result.init}, chi2 {result.initial_chi2:.6g}"),
            (
                "result",
                f"chi2 {result.chi2:.6g} in {result.iterations} iterations of {result.method}",
            ),
            *rows_of_decision(result),
            *_robust(result),
            ("stopped", result.message),
            ("optimum", _optimum(result)),
            ("reduced chi2", _quality(result.reduced_chi2)),
            ("not optimized", f"node {gauge}" if gauge else "nothing: measurements hold all nodes"),
            ("time", ", ".join(f"{k} {show.duration(v)}" for k, v in times.items())),
            ("written", ", ".join(map(str, written)) or "nothing: name a file with -o"),
        ]
    )


def _sizes(graph: PoseGraph) -> str:
    said = f"{len(graph)} nodes, {len(graph.edges)} edges"
    if graph.priors is not None:
        said += f", {len(graph.priors)} priors"
    if graph.landmarks is not None:
        seen = graph.landmarks
        said += f", {len(seen)} landmarks, {len(seen.observations)} observations"
    return said


def _robust(result: Result) -> list[tuple[str, str]]:
    counts = show.weight_counts(result)
    if counts is None:
        return []
    said = ", ".join(f"{count} {name.replace('_', ' ')}" for name, count in counts.items())
    return [("robust cost", f"{result.robust_cost:.6g} with {result.loss}; weights: {said}")]


def _optimum(result: Result) -> str:
    certificate, seen = result.certificate, result.graph.landmarks
    if certificate is None:
        return "not certified"
    said = f"{show.status(certificate)}: {certificate.message.partition(': ')[2]}"
    if certificate.better is not None:
        return f"{said}; masat certify -o writes it"
    without_bound = seen is not None and seen.range_bearing is not None
    return (
        said
        if certificate.certified or without_bound
        else f"{said}; masat certify searches further"
    )


def _quality(reduced: float | None) -> str:
    if reduced is None:
        return "- (nothing is measured twice)"
    if reduced > 2:
        hint = "(over 1: false loop closures, a local minimum, or information that is too large)"
    elif reduced < 0.5:
        hint = "(under 1: the measurements are better than their information says)"
    else:
        hint = "(about 1: the residuals are as large as the information says)"
    return f"{reduced:.4g} {hint}"
