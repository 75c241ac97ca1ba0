"""`masat convert`."""

from __future__ import annotations

from pathlib import Path

import click

from masat.cli import options, show
from masat.formats import format_of, write


@click.command(epilog="Example:  masat convert w10000.graph.gz w10000.g2o")
@options.graph_file
@click.argument("out", type=click.Path(path_type=Path))
@options.output
def convert(
    file: Path, file_format: str | None, indefinite: str, out: Path, as_json: bool, quiet: bool
) -> None:
    """Write the pose graph in FILE to OUT in the format of g2o.

    The name of OUT ends in .g2o or .txt, or has no suffix; with .gz after it, OUT is compressed.
    """
    options.check_outputs(file, out)
    format_of(out)
    graph = options.load(file, file_format, indefinite, quiet)
    write(graph, out)
    if as_json:
        show.as_json(
            {
                "file": str(file),
                "out": str(out),
                "nodes": len(graph),
                "edges": len(graph.edges),
                "notes": list(graph.notes),
            }
        )
    elif not quiet:
        click.echo(f"{out}: {len(graph)} nodes, {len(graph.edges)} edges")
