"""`masat simulate`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import click

from masat.cli import options, show
from masat.errors import MasatError
from masat.formats import format_of, write
from masat.worlds import WORLDS, perturb


def _sigmas(
    context: click.Context, parameter: click.Parameter, texts: tuple[str, ...]
) -> list[float]:
    try:
        return [float(number) for text in texts for number in text.split(",")]
    except ValueError:
        raise click.BadParameter("expected numbers, as in 0.1,0.1,0.05") from None


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
    "--seed",
    type=click.IntRange(min=0),
    default=0,
    show_default=True,
    help="Seed of the random walk and of the noise.",
)
@click.option(
    "--truth",
    type=click.Path(path_type=Path),
    help="File for the graph with its true poses and without noise.",
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
    size = {name: n for name, n in (("nodes", nodes), ("edges", edges)) if n is not None}
    try:
        exact = WORLDS[world](**size, seed=seed)
        measured = perturb(exact, noise, seed=seed) if noise else exact
    except MemoryError:
        raise MasatError("there is not enough memory for a world of this size") from None
    write(replace(measured, poses=None), out)
    if truth is not None:
        write(exact, truth)
    if picture is not None:
        from masat.plotting import plot

        plot({f"{world}, truth": exact}, picture)
    counts = {"nodes": len(exact.ids), "edges": len(exact.edges)}
    if as_json:
        files = {"out": str(out), "truth": None if truth is None else str(truth)}
        show.as_json({"world": world, **files, **counts, "noise": noise, "seed": seed})
    elif not quiet:
        click.echo(f"{out}: {counts['nodes']} nodes, {counts['edges']} edges")
