"""`masat convert`."""

from __future__ import annotations

from pathlib import Path

import click

from masat.cli import options, show
from masat.formats import FORMATS, format_of, write
from masat.graph import PoseGraph

_WRITTEN = [name for name, table in FORMATS.items() if table.format_graph]


@click.command(epilog="Example:  masat convert w10000.graph.gz w10000.g2o")
@options.graph_file
@click.argument("out", type=click.Path(path_type=Path))
@click.option(
    "--to",
    type=click.Choice(_WRITTEN),
    help="Format of OUT.  [default: by its suffix]",
)
@options.output
def convert(
    file: Path,
    file_format: str | None,
    indefinite: str,
    out: Path,
    to: str | None,
    as_json: bool,
    quiet: bool,
) -> None:
    """Write the pose graph or trajectory in FILE to OUT.

    The suffix of OUT is the format: .g2o, .txt or none is g2o, .tum and .kitti are trajectories,
    which hold poses without edges. With .gz after it, OUT is compressed. Other suffixes are
    refused, unless --to names the format.
    """
    options.check_outputs(file, out)
    chosen = format_of(out) if to is None else to
    graph = options.load(file, file_format, indefinite, quiet)
    write(graph, out, format=chosen)
    lost = _not_written(graph, chosen)
    if as_json:
        show.as_json(
            {
                "file": str(file),
                "out": str(out),
                "format": chosen,
                "nodes": len(graph),
                "edges": len(graph.edges),
                "notes": [*graph.notes, *lost],
            }
        )
    elif not quiet:
        options.notes(lost)
        click.echo(f"{out}: {_contents(graph, chosen)}")


def _is_trajectory(name: str) -> bool:
    return "poses" in FORMATS[name].needs


def _contents(graph: PoseGraph, name: str) -> str:
    if _is_trajectory(name):
        return f"{len(graph)} poses"
    return f"{len(graph)} nodes, {len(graph.edges)} edges"


def _not_written(graph: PoseGraph, name: str) -> tuple[str, ...]:
    """Return notes about what the format has no place for."""
    if not _is_trajectory(name):
        return ()
    notes = []
    lost = [(len(graph.edges), "edges")]
    lost += [] if graph.priors is None else [(len(graph.priors), "priors")]
    lost += [] if graph.landmarks is None else [(len(graph.landmarks), "landmarks")]
    named = [f"{count} {what}" for count, what in lost if count]
    if named:
        several = " and ".join([", ".join(named[:-1]), named[-1]] if named[1:] else named)
        notes.append(f"a trajectory holds poses alone: {several} are not written")
    if graph.stamps is not None and "stamps" not in FORMATS[name].needs:
        notes.append(f"the format {name!r} has no stamps: they are not written")
    return tuple(notes)
