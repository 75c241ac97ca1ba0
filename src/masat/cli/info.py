"""`masat info`."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import click

from masat.cli import options, show
from masat.cli.partition import describe
from masat.diagnostics import Diagnosis, diagnose
from masat.errors import MasatError
from masat.parts import Partition


@click.command(epilog="Example:  masat info M3500.g2o")
@options.graph_file
@click.option(
    "--plot",
    "picture",
    type=click.Path(path_type=Path),
    help="Picture of FILE's own poses, each edge colored by its chi2.",
)
@options.output
def info(
    file: Path,
    file_format: str | None,
    indefinite: str,
    picture: Path | None,
    as_json: bool,
    quiet: bool,
) -> None:
    """Describe the pose graph in FILE: sizes, connectivity, information, fit, and issues.

    Of a folder that masat partition made, say what a solve on how many workers costs.

    Each issue says what was found, and then what to do before a result is trusted.
    """
    if file.is_dir():
        if picture is not None:
            raise click.UsageError("--plot does not go with a folder of parts")
        describe(Partition(file), as_json)
        return
    options.check_picture(picture)
    graph = options.load(file, file_format, indefinite, quiet=True)
    if picture is not None and graph.poses is None:
        raise MasatError(f"{file} has no poses to draw: masat solve --plot draws a solved map")
    diagnosis = diagnose(graph)
    if picture is not None:
        from masat.plotting import plot

        plot(graph, picture, color_by_error=True)
    if as_json:
        show.as_json({"file": str(file), **dataclasses.asdict(diagnosis)})
    elif not quiet:
        _tell(diagnosis)


def _tell(d: Diagnosis) -> None:
    sizes = ", ".join(map(str, d.components[:5])) + (", ..." if len(d.components) > 5 else "")
    # Without edges there are no worst ones, though there may be poses.
    fit = "no poses in the file"
    if d.chi2 is None and d.worst_edges:
        fit = "no positions of the landmarks in the file"
    if d.chi2 is not None:
        fit = f"chi2 {d.chi2:.6g}, reduced {show.number(d.reduced_chi2)}"
    rows = [
        ("dimension", f"{d.dimension}D"),
        ("nodes", f"{d.nodes}, ids {d.ids[0]} to {d.ids[1]}, {len(d.fixed)} fixed"),
        (
            "edges",
            f"{d.edges}: {d.odometry_edges} odometry, {d.loop_closures} loop closures, "
            f"{d.repeated_pairs} pairs of nodes with more than one edge",
        ),
        *_more(d),
        ("components", f"{len(d.components)}, of {sizes} nodes"),
        ("degree", f"{d.degree[0]} to {d.degree[2]} edges at a node, median {d.degree[1]:g}"),
        (
            "information",
            f"eigenvalues {d.information[0]:.4g} to {d.information[1]:.4g}, "
            f"condition up to {d.condition:.3g}",
        ),
        ("own poses", fit),
    ]
    if d.worst_edges:
        worst = ", ".join(f"{a} -> {b} ({chi2:.3g})" for a, b, chi2 in d.worst_edges[:3])
        rows.append(("worst edges", worst))
    rows += [("issues", issue) for issue in d.issues or ("none",)]
    for name, text in rows:
        click.echo(f"{name:<12} {text}")


def _more(d: Diagnosis) -> list[tuple[str, str]]:
    """Return what to say of priors and landmarks, if there are any."""
    rows = [("priors", f"{d.priors}")] if d.priors else []
    if d.landmarks:
        rows.append(("landmarks", f"{d.landmarks}, {d.observations} observations"))
    return rows
