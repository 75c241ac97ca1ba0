"""`masat merge`."""

from __future__ import annotations

from pathlib import Path
from time import perf_counter
from typing import Any

import click

from masat.cli import EXIT_NOT_CONVERGED, options, show
from masat.cli.decisions import rejected_part
from masat.cli.progress import Stages
from masat.cli.solve import print_result
from masat.formats import format_of, read_links, write
from masat.graph import PoseGraph
from masat.merging import merge as merged
from masat.merging import note_on_frames
from masat.optimizers import Result
from masat.solver import solve as solved


@click.command(
    epilog="Example:  masat merge monday.g2o tuesday.g2o --between links.txt --robust -o map.g2o"
)
@click.argument(
    "files", metavar="FILE...", nargs=-1, required=True, type=click.Path(path_type=Path)
)
@options.reading
@click.option(
    "--between",
    "links",
    metavar="LINKS",
    type=click.Path(path_type=Path),
    help="Links between the sessions: a table, or a graph whose edges have the ids that --ids "
    "prints.",
)
@click.option(
    "-o", "--output", "out", type=click.Path(path_type=Path), help="Map: .g2o, .tum or .kitti."
)
@click.option(
    "--ids", "show_ids", is_flag=True, help="Print the ids that the nodes get, and do no more."
)
@click.option(
    "--robust",
    is_flag=True,
    help="Reject false links, and false loop closures, priors and observations of landmarks within "
    "the sessions.",
)
@click.option(
    "--rejected",
    type=click.Path(path_type=Path),
    help="Where to write the edges, priors and observations that --robust rejects, and nothing "
    "else, in g2o.",
)
@click.option(
    "--common-frame",
    is_flag=True,
    help="The fixed nodes of all sessions are in one frame, and remain fixed.  [default: sessions "
    "with position fixes are in the world's frame, each other one in its own]",
)
@click.option(
    "--solve/--no-solve",
    "with_map",
    default=True,
    show_default=True,
    help="Whether to make a map, or only to write the merged graph.",
)
@options.search
@options.output
@click.pass_context
def merge(
    ctx: click.Context,
    files: tuple[Path, ...],
    file_format: str | None,
    indefinite: str,
    links: Path | None,
    out: Path | None,
    show_ids: bool,
    robust: bool,
    rejected: Path | None,
    common_frame: bool,
    with_map: bool,
    seed: int,
    budget: float | None,
    as_json: bool,
    quiet: bool,
) -> None:
    """Merge the sessions in FILE... into one map.

    Each session has ids of its own, and a frame of its own unless it has position fixes. No initial
    guess is needed between them. A line of LINKS says where they meet:

    \b
        session id session id   x y theta   information
        0 812 1 17   0.4 -0.1 1.57   50 0 0 50 0 200

    Sessions count from 0 in the order of the files, and ids are those of the files. The measurement
    is the pose of the second node as seen from the first, in 3D x y z qx qy qz qw. The information
    is the upper triangle, 6 or 21 numbers; without it, it is the identity.

    In the map, node 17 of session 1 is 1000017; --ids prints what the ids are shifted by. Sessions
    that neither links nor priors connect stay side by side in one file, each in a frame of its own.
    """  # noqa: D301
    if not with_map and (robust or rejected is not None):
        raise click.UsageError("--robust and --rejected make a map: leave out --no-solve")
    if rejected is not None and not robust:
        raise click.UsageError("--rejected goes with --robust")
    for source in (*files, links):
        options.check_outputs(source, out, rejected)
    if out is not None:
        format_of(out)
    options.check_rejected(rejected)
    begin = perf_counter()
    parts = [options.load(file, file_format, indefinite, quiet) for file in files]
    between = None if links is None else read_links(links)
    graph = merged(parts, between, common_frame=common_frame)
    read_seconds = perf_counter() - begin
    table = _sessions(files, parts, graph)
    if show_ids:
        _print_ids(table, as_json)
        return
    options.check_stamps(graph, out)
    known = {note for part in parts for note in part.notes}
    result = None
    if with_map:
        with Stages("merge", quiet=quiet) as stages:
            result = solved(graph, robust=robust, seed=seed, budget=budget, report_stage=stages)
    final = graph if result is None else result.graph
    if not quiet:
        if result is not None:
            known.add(note_on_frames(parts))  # no longer so
        options.notes(note for note in final.notes if note not in known)
        apart = sum(part.priors is None for part in parts)
        if links is None and len(parts) > 1 and apart:
            which = "each" if apart == len(parts) else "each session without priors"
            options.notes([f"without links (--between) {which} stays in a frame of its own"])
    if out is not None:
        write(final, out)
    if rejected is not None and result is not None:
        write(rejected_part(graph, result), rejected)
    if as_json:
        show.as_json(_about(table, final, result))
    elif not quiet:
        for row in table:
            click.echo(f"session {row['session']}: {_row(row)}")
        written = [path for path in (out, rejected) if path is not None]
        if result is None:
            where = "" if out is None else f"{out}: "
            click.echo(f"{where}{len(final)} nodes, {len(final.edges)} edges")
        else:
            times = {
                "read": read_seconds,
                "initial guess": result.init_seconds,
                "optimize": result.seconds,
            }
            print_result(result, times, written)
    if result is not None and not result.converged:
        if quiet or as_json:
            click.echo(f"masat: {result.message}", err=True)
        ctx.exit(EXIT_NOT_CONVERGED)


def _sessions(
    files: tuple[Path, ...], parts: list[PoseGraph], graph: PoseGraph
) -> list[dict[str, Any]]:
    """Return what there is to say of each session."""
    rows, begin = [], 0
    for number, (file, part) in enumerate(zip(files, parts, strict=True)):
        first = int(graph.ids[begin])
        rows.append(
            {
                "session": number,
                "file": str(file),
                "nodes": len(part),
                "ids": [int(part.ids[0]), int(part.ids[-1])],
                "shift": first - int(part.ids[0]),
                "merged_ids": [first, int(graph.ids[begin + len(part) - 1])],
            }
        )
        begin += len(part)
    return rows


def _row(row: dict[str, Any]) -> str:
    first, last = row["ids"]
    begin, end = row["merged_ids"]
    return f"{row['file']}, {row['nodes']} nodes, ids {first} to {last} become {begin} to {end}"


def _print_ids(table: list[dict[str, Any]], as_json: bool) -> None:
    if as_json:
        show.as_json({"sessions": table})
        return
    for row in table:
        click.echo(f"session {row['session']} (+ {row['shift']}): {_row(row)}")


def _about(table: list[dict[str, Any]], final: PoseGraph, result: Result | None) -> dict[str, Any]:
    about: dict[str, Any] = {
        "sessions": table,
        "nodes": len(final),
        "edges": len(final.edges),
        "maps": int(final.components.max()) + 1,
        "notes": list(final.notes),
    }
    if result is None:
        return about
    return (
        about | show.summary(result) | {"decision": result.decision and result.decision.to_dict()}
    )
