"""`masat partition`, and what other commands do with the folder that it makes."""

from __future__ import annotations

import dataclasses
from contextlib import nullcontext
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import click
import numpy as np

from masat.arrays import Ids
from masat.cli import EXIT_NOT_CONVERGED, options, show
from masat.cli.cluster import connect
from masat.cli.progress import Iterations
from masat.errors import PartitionError
from masat.formats import format_of, write
from masat.formats.streaming import read_mapped
from masat.graph import PoseGraph
from masat.parts import Partition
from masat.parts import partition as partitioned
from masat.parts.index import Index

_SHOWN = 10  # iterations that masat status lists


@click.command(epilog="Example:  masat partition city.g2o -o city.parts --parts 8")
@options.graph_file
@click.option(
    "-o",
    "--output",
    "out",
    type=click.Path(path_type=Path),
    required=True,
    help="Folder for the parts: empty, or not there yet.",
)
@click.option("--parts", type=click.IntRange(min=1), help="Number of parts.")
@click.option(
    "--labels",
    type=click.Path(path_type=Path),
    help="In the place of --parts, a table with the lines 'id part': parts are numbered from 0.",
)
@options.output
def partition(
    file: Path,
    file_format: str | None,
    indefinite: str,
    out: Path,
    parts: int | None,
    labels: Path | None,
    as_json: bool,
    quiet: bool,
) -> None:
    """Cut the pose graph in FILE into parts, for maps that one machine or its memory cannot hold.

    masat info, solve and status take the folder in the place of a file.
    """
    if (parts is None) == (labels is None):
        raise click.UsageError("give either --parts or --labels")
    if not out.absolute().parent.is_dir():
        raise PartitionError(f"{out}: its folder does not exist")
    with TemporaryDirectory(dir=out.absolute().parent, prefix=f".{out.name[:50]}.") as mapped:
        # A graph that needs repairs has to be in memory as a whole.
        if indefinite == "error" and not options.is_saved_result(file):
            graph = read_mapped(file, Path(mapped), format=file_format)
        else:
            graph = options.load(file, file_format, indefinite, quiet or as_json)
        given = None if labels is None else _read_labels(labels, graph)
        made = partitioned(graph, out, parts, labels=given)
        del graph
    if as_json or not quiet:
        describe(made, as_json)


def _read_labels(path: Path, graph: PoseGraph) -> Ids:
    try:
        table = np.loadtxt(path, dtype=np.int64, ndmin=2)
    except ValueError as error:
        raise PartitionError(f"{path}: not a table of 'id part': {error}") from None
    if table.shape[1:] != (2,):
        raise PartitionError(f"{path}: has {table.shape[1]} columns, expected 'id part'")
    found = np.full(len(graph), -1, np.int64)
    found[graph.index(table[:, 0])] = table[:, 1]
    for k in np.flatnonzero(found < 0)[:1]:
        raise PartitionError(f"{path}: names no part from 0 on for node {graph.ids[k]}")
    return found


def describe(partition: Partition, as_json: bool) -> None:
    """Print what a partition consists of, and what its factorization costs."""
    index, costs = partition.index, partition.costs()
    if as_json:
        about = {key: value for key, value in dataclasses.asdict(index).items() if key != "pieces"}
        about["costs"] = [cost._asdict() for cost in costs]
        show.as_json({"folder": str(partition.folder), **about})
        return
    of_parts = index.pieces[: index.parts]
    show.rows(
        [
            ("partition", f"{index.dimension}D, {index.nodes} nodes, {index.edges} edges"),
            *_other_measurements(index),
            (
                "parts",
                f"{index.parts}, of {min(e.own for e in of_parts)} to "
                f"{max(e.own for e in of_parts)} nodes",
            ),
            (
                "separators",
                f"{len(index.pieces) - index.parts}, of {index.separators} nodes together",
            ),
            ("files", _bytes(sum(entry.size for entry in index.pieces))),
        ]
    )
    columns = ("workers", "memory of the largest", "operations", "speedup", "sent an iteration")
    show.table(
        columns,
        [
            (
                str(cost.workers),
                _bytes(cost.memory),
                f"{cost.operations:.2g}",
                f"{cost.speedup:.1f}",
                _bytes(cost.sent),
            )
            for cost in costs
        ],
    )
    best = max(costs, key=lambda cost: (round(cost.speedup, 1), -cost.workers))
    click.echo(
        f"up to {best.workers} workers help; each of them needs {_bytes(best.memory)} and what "
        "Python takes"
    )


def _other_measurements(index: Index) -> list[tuple[str, str]]:
    """Return rows about priors, landmarks, and what is not determined."""
    rows = []
    if index.priors:
        rows.append(("priors", str(index.priors)))
    if index.landmarks:
        rows.append(("landmarks", f"{index.landmarks}, seen {index.observations} times"))
    return rows + [("note", note) for note in index.notes]


def solve_parts(
    ctx: click.Context,
    folder: Path,
    out: Path | None,
    init: str,
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
    """Solve a partition, or go on, and print what was found."""
    made = Partition(folder)
    if out is not None:
        options.check_outputs(None, out)
        format_of(out)
    client = nullcontext() if scheduler is None else connect(scheduler, PartitionError)
    iterations = Iterations(folder.name, max_iterations, quiet=quiet)
    with client as connected, iterations:
        result = made.solve(
            optimizer,
            init=None if init == "auto" else init,
            loss=loss,
            scale=loss_scale,
            restart=restart,
            client=connected,
            memory=memory,
            threads=1 if threads is None else threads,
            max_iterations=max_iterations,
            relative_tolerance=tolerance,
            report=iterations,
        )
    if out is not None:
        write(made.graph(), out)
    if as_json:
        about: dict[str, Any] = dataclasses.asdict(result)
        about |= {"reason": result.reason.name.lower(), "converged": result.converged}
        about["history"] = [iteration._asdict() for iteration in result.history]
        show.as_json({"folder": str(folder), **about})
    elif not quiet:
        show.rows(
            [
                ("partition", f"{made.index.nodes} nodes in {made.index.parts} parts"),
                ("initial guess", f"{result.init}, chi2 {result.initial_chi2:.6g}"),
                (
                    "result",
                    f"chi2 {result.chi2:.6g} in {result.iterations} iterations of {result.method}",
                ),
                *(
                    []
                    if result.robust_cost is None
                    else [("robust cost", f"{result.robust_cost:.6g} with {result.loss}")]
                ),
                ("stopped", result.message),
                ("time", show.duration(result.seconds)),
                ("written", f"poses in {folder}" + ("" if out is None else f", {out}")),
            ]
        )
    if not result.converged:
        if quiet or as_json:
            click.echo(f"masat: {folder}: {result.message}", err=True)
        ctx.exit(EXIT_NOT_CONVERGED)


def tell_status(folder: Path, as_json: bool) -> None:
    """Print how far the solve of a partition is."""
    made = Partition(folder)
    found = made.status()
    if as_json:
        state = None
        if found is not None:
            state = dataclasses.asdict(found)
            state["history"] = [iteration._asdict() for iteration in found.history]
        show.as_json({"folder": str(folder), "solve": state})
        return
    if found is None:
        click.echo(f"not solved yet: masat solve {folder}")
        return
    done = f"{len(found.history)} iterations of {found.method}"
    said = f"stopped, {found.reason.lower().replace('_', ' ')}" if found.reason else "not finished"
    cost, options_of_loss = "chi2", ""
    if found.loss is not None:
        name, scale = found.loss
        cost, options_of_loss = f"cost with {name}", f" --loss {name} --loss-scale {scale:.17g}"
    show.rows(
        [
            ("state", f"{said}, after {done}"),
            ("initial guess", f"{found.init}, chi2 {found.initial_chi2:.6g}"),
            (f"lowest {cost}", f"{found.chi2:.6g}"),
        ]
    )
    if found.history:
        first = max(0, len(found.history) - _SHOWN)
        show.table(
            ("iteration", "chi2" if found.loss is None else "cost", "step", "seconds"),
            [
                (str(k + 1), f"{one.chi2:.6g}", f"{one.step:.3g}", f"{one.seconds:.2f}")
                for k, one in enumerate(found.history)
                if k >= first
            ],
        )
    if found.reason is None:
        click.echo(f"to go on: masat solve {folder}{options_of_loss}")


def _bytes(count: float) -> str:
    for unit in ("B", "kB", "MB", "GB"):
        if count < 1000:
            return f"{count:.3g} {unit}"
        count /= 1000
    return f"{count:.3g} TB"
