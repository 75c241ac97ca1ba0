"""`masat solve`."""

from __future__ import annotations

from pathlib import Path
from time import perf_counter
from typing import Any

import click

from masat.cli import EXIT_NOT_CONVERGED, options, show
from masat.formats import write
from masat.initializers import initialize
from masat.optimality.certificate import Certificate, certify
from masat.optimizers import Result, optimize

_NAMES = {True: "cost", False: "chordal cost"}


@click.command(
    epilog="Example:  masat solve M3500.g2o -o map.g2o --plot map.png",
)
@options.graph_file
@click.option(
    "-o", "--output", "out", type=click.Path(path_type=Path), help="Map, in g2o; .gz gzips it."
)
@click.option(
    "--plot", "picture", type=click.Path(path_type=Path), help="Picture, before and after."
)
@click.option(
    "--save", type=click.Path(path_type=Path), help="Result with its history, .npz (Result.load)."
)
@options.start
@options.optimizer
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
    optimizer: str,
    max_iterations: int,
    tolerance: float,
    threads: int,
    as_json: bool,
    quiet: bool,
) -> None:
    """Optimize the pose graph in FILE: read, initialize, optimize, write, draw.

    Nodes named by FIX keep their poses; without such, the smallest id of each component does.
    """
    options.check_writable(out, file)
    options.check_writable(save, file)
    options.check_picture(picture)
    begin = perf_counter()
    graph = options.load(file, file_format, indefinite, quiet)
    loaded = perf_counter()
    with show.Wait(f"{file.name}  start {init}", quiet=quiet):
        guess = initialize(graph, init, root=root)
        guessed = perf_counter()
    if not quiet:
        options.notes(guess.notes[len(graph.notes) :])
    with show.Watch(file.name, max_iterations, quiet=quiet) as watch:
        result = optimize(
            guess,
            options.OPTIMIZER_NAMES[optimizer],
            max_iterations=max_iterations,
            relative_tolerance=tolerance,
            threads=threads,
            report=watch,
        )
    if out is not None:
        write(result.graph, out)
    if save is not None:
        result.save(save)
    if picture is not None:
        from masat.plotting import plot

        plot({f"{init}: chi2 {result.initial_chi2:.4g}": guess,
              f"optimized: chi2 {result.chi2:.4g}": result.graph}, picture)  # fmt: skip
    times = {"read": loaded - begin, "initialize": guessed - loaded, "optimize": result.seconds}
    proof = None
    if result.converged and (as_json or not quiet):
        with show.Wait(f"{file.name}  certificate", quiet=quiet):
            proof = certify(result.graph, lift=False, threads=threads)
    if as_json:
        about: dict[str, Any] = {
            "file": str(file),
            "nodes": len(graph.ids),
            "edges": len(graph.edges),
            "init": init,
            "notes": list(guess.notes),
            "times": times,
        }
        show.as_json(about | show.summary(result) | {"certificate": show.certificate(proof)})
    elif not quiet:
        written = [p for p in (out, save, picture) if p is not None]
        _tell(result, proof, init, times, written)
    if not result.converged:
        if quiet or as_json:
            click.echo(f"masat: {file}: {result.message}", err=True)
        ctx.exit(EXIT_NOT_CONVERGED)


def _tell(
    result: Result,
    proof: Certificate | None,
    init: str,
    times: dict[str, float],
    written: list[Path],
) -> None:
    graph = result.graph
    shown = ", ".join(map(str, result.gauge[:5])) + (", ..." if len(result.gauge) > 5 else "")
    rows = [
        ("graph", f"{graph.dimension}D, {len(graph.ids)} nodes, {len(graph.edges)} edges"),
        ("start", f"{init}, chi2 {result.initial_chi2:.6g}"),
        ("result", f"chi2 {result.chi2:.6g} in {result.iterations} iterations of {result.method}"),
        ("stopped", result.message),
        ("optimum", _optimum(proof)),
        ("reduced chi2", _quality(result.reduced_chi2)),
        ("held still", f"node {shown}"),
        ("time", ", ".join(f"{k} {show.duration(v)}" for k, v in times.items())),
        ("written", ", ".join(map(str, written)) or "nothing: name a file with -o"),
    ]
    for name, text in rows:
        click.echo(f"{name:<13} {text}")


def _optimum(proof: Certificate | None) -> str:
    if proof is None:
        return "not certified: not converged"
    if proof.better is not None:
        return f"not global: chi2 {proof.optimum:.6g} is known, masat certify -o writes it"
    if proof.certified:
        return f"global, certified to {proof.gap:.1g} of the {_NAMES[proof.exact]}"
    return "not certified: ask masat certify, which may find a better one"


def _quality(reduced: float | None) -> str:
    if reduced is None:
        return "- (nothing is measured twice)"
    if reduced > 2:
        hint = "(over 1: wrong edges, a local minimum, or information that promises too much)"
    elif reduced < 0.5:
        hint = "(under 1: the measurements are better than their information says)"
    else:
        hint = "(about 1: the residuals are as large as the information says)"
    return f"{reduced:.4g} {hint}"
