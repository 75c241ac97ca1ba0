"""`masat status`."""

from __future__ import annotations

from pathlib import Path

import click

from masat.cli.partition import tell_status


@click.command(epilog="Example:  masat status city.parts")
@click.argument("folder", type=click.Path(path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def status(folder: Path, as_json: bool) -> None:
    """Tell how far the solve of a graph in parts is: its iterations, and the lowest chi2.

    FOLDER is what masat partition made.
    """
    tell_status(folder, as_json)
