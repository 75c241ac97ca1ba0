"""`masat simulate`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import click
import numpy as np

from masat.arrays import Flags
from masat.chain import odometry_edges
from masat.cli import options, show
from masat.errors import MasatError
from masat.formats import format_of, write
from masat.graph import PoseGraph
from masat.worlds import WORLDS, add_false_closures, perturb
from masat.worlds.false_closures import KINDS


def _sigmas(
    context: click.Context, parameter: click.Parameter, texts: tuple[str, ...]
) -> list[float]:
    try:
        return [float(number) for text in texts for number in text.split(",")]
    except ValueError:
        raise click.BadParameter("expected numbers, as in 0.1,0.1,0.05") from None


def _kind_and_fraction(
    context: click.Context, parameter: click.Parameter, text: str | None
) -> tuple[str, float] | None:
    if text is None:
        return None
    kind, _, fraction = text.partition(":")
    try:
        if kind in KINDS and 0 <= float(fraction) < 1:
            return kind, float(fraction)
    except ValueError:
        pass
    raise click.BadParameter(
        f"expected one of {', '.join(KINDS)}, a colon and a fraction of at least 0 and below 1, as "
        f"in random:0.5; got {text!r:.40}"
    )


def _spoiled(graph: PoseGraph, kind: str, fraction: float, seed: int) -> tuple[PoseGraph, Flags]:
    """Add false loop closures, and label all edges."""
    labels = np.where(odometry_edges(graph), "odometry", "closure")
    return add_false_closures(replace(graph, labels=labels), kind, fraction, seed=seed)


@click.command(
    epilog="Example:  masat simulate city --nodes 2000 --noise 0.1,0.1,0.05 -o city.g2o "
    "--truth city_truth.g2o"
)
@click.argument("world", type=click.Choice(list(WORLDS)))
@click.option(
    "-o",
    "--output",
    "out",
    type=click.Path(path_type=Path),
    required=True,
    help="File for the measurements.",
)
@click.option(
    "--nodes", type=click.IntRange(min=2), help="Number of poses.  [default: as the public graph]"
)
@click.option(
    "--edges",
    type=click.IntRange(min=1),
    help="Number of measurements.  [default: as many per pose as the public graph]",
)
@click.option(
    "--noise",
    multiple=True,
    callback=_sigmas,
    metavar="SIGMA,...",
    help="Standard deviations of the measurements in meters and radians. 2D: x,y,theta. 3D: "
    "translation,rotation or x,y,z and the three of the rotation vector.  [default: no noise]",
)
@click.option(
    "--false",
    "false",
    callback=_kind_and_fraction,
    metavar="KIND:FRACTION",
    help="Add false loop closures, so many that they are this fraction of all. Needs --noise. "
    f"Kinds: {', '.join(KINDS)}. All edges are labeled: odometry, closure or false.",
)
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    default=0,
    show_default=True,
    help="Seed of the random walk, of the noise and of the false loop closures.",
)
@click.option(
    "--truth",
    type=click.Path(path_type=Path),
    help="File for the graph with its true poses, without noise and without false loop closures.",
)
@click.option(
    "--plot", "picture", type=click.Path(path_type=Path), help="File for a picture of the true map."
)
@options.output
def simulate(
    world: str,
    out: Path,
    nodes: int | None,
    edges: int | None,
    noise: list[float],
    false: tuple[str, float] | None,
    seed: int,
    truth: Path | None,
    picture: Path | None,
    as_json: bool,
    quiet: bool,
) -> None:
    """Simulate a robot's walk through WORLD and write its measurements in the format of g2o.

    Worlds in 2D: manhattan (like the public graph M3500), city (City10k). Worlds in 3D: sphere
    (sphere2500), torus (torus3D), grid (grid3D), garage (parking-garage).

    The output file has measurements and no poses, so that the initial guess has to be computed. The
    true poses are written to another file with --truth.
    """
    options.check_outputs(None, out, truth, picture)
    for target in (out, truth):
        if target is not None:
            format_of(target)
    options.check_picture(picture)
    if false is not None and not noise:
        raise click.UsageError(
            "--false needs --noise: a loop closure is false if its residual is far beyond the noise"
        )
    size = {name: n for name, n in (("nodes", nodes), ("edges", edges)) if n is not None}
    try:
        exact = WORLDS[world](**size, seed=seed)
        measured = perturb(exact, noise, seed=seed) if noise else exact
        false_count = None
        if false is not None:
            measured, is_false = _spoiled(measured, *false, seed)
            false_count = int(is_false.sum())
    except MemoryError:
        raise MasatError("there is not enough memory for a world of this size") from None
    write(replace(measured, poses=None), out)
    if truth is not None:
        write(exact, truth)
    if picture is not None:
        from masat.plotting import plot

        plot({f"{world}, truth": exact}, picture)
    counts = {"nodes": len(measured.ids), "edges": len(measured.edges)}
    if as_json:
        files = {"out": str(out), "truth": None if truth is None else str(truth)}
        show.as_json(
            {"world": world, **files, **counts, "false": false_count, "noise": noise, "seed": seed}
        )
    elif not quiet:
        part = "" if false_count is None else f", {false_count} of them false loop closures"
        click.echo(f"{out}: {counts['nodes']} nodes, {counts['edges']} edges{part}")
