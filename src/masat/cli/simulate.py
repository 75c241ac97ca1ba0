"""`masat simulate`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import numpy as np

from masat.arrays import Flags, Floats
from masat.chain import odometry_edges
from masat.cli import options, show
from masat.errors import MasatError
from masat.formats import format_of, write
from masat.graph import PoseGraph
from masat.worlds import WORLDS, add_false_closures, add_fixes, add_landmarks, perturb
from masat.worlds.false_closures import KINDS
from masat.worlds.fixes import BAD_METERS


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


def _gps(
    context: click.Context, parameter: click.Parameter, text: str | None
) -> tuple[float, float, float] | None:
    if text is None:
        return None
    try:
        numbers = [float(word) for word in text.split(":")]
        if len(numbers) in (2, 3):
            return numbers[0], numbers[1], numbers[2] if len(numbers) == 3 else 0.0
    except ValueError:
        pass
    raise click.BadParameter(
        "expected the fraction of nodes with a fix, a colon and sigma in meters, as in 0.05:2; "
        f"perhaps another colon and the fraction of bad fixes, as in 0.05:2:0.3; got {text!r:.40}"
    )


def _landmarks(
    context: click.Context, parameter: click.Parameter, text: str | None
) -> dict[str, Any] | None:
    if text is None:
        return None
    count, *more = text.split(":")
    try:
        numbers = [float(word) for word in more]
        if len(numbers) <= 3:
            names = ("sigma", "reach", "sigma_bearing")
            return {"count": int(count)} | dict(zip(names, numbers, strict=False))
    except ValueError:
        pass
    raise click.BadParameter(
        "expected a number of landmarks, perhaps with a colon and sigma in meters, another colon "
        "and the reach in meters, and another and sigma of the bearings in radians, as in 200 or "
        f"200:0.1:8:0.01; got {text!r:.40}"
    )


def _frame(exact: PoseGraph, numbers: list[float]) -> Floats | None:
    """Return the pose of a world in the frame of its fixes, given an offset and a heading."""
    d = exact.dimension
    if not numbers:
        return None
    if len(numbers) != d + 1:
        names = "EAST,NORTH,HEADING" if d == 2 else "EAST,NORTH,UP,HEADING"
        raise click.UsageError(f"--frame of a {d}D world needs {d + 1} numbers: {names}")
    heading = np.radians(numbers[d])
    if d == 2:
        return np.array([*numbers[:2], heading])
    return np.array([*numbers[:3], 0, 0, np.sin(heading / 2), np.cos(heading / 2)])


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
    "--gps",
    callback=_gps,
    metavar="FRACTION:SIGMA[:BAD]",
    help="Add position fixes with a standard deviation of SIGMA meters to this fraction of the "
    f"nodes. The fraction BAD of the fixes is {BAD_METERS:g} m off.",
)
@click.option(
    "--frame",
    multiple=True,
    callback=_sigmas,
    metavar="EAST,NORTH,[UP,]HEADING",
    help="Where the world lies in the frame of --gps: an offset in meters, and degrees "
    "counterclockwise from east.  [default: the frames are the same]",
)
@click.option(
    "--landmarks",
    callback=_landmarks,
    metavar="COUNT[:SIGMA[:REACH[:BEARING]]]",
    help="Add points along the walk, and observations of them with a standard deviation of SIGMA "
    "meters from poses at most REACH meters away.  [default: 0.1 m and 8 m] With BEARING, ranges "
    "with a standard deviation of SIGMA and bearings with one of BEARING radians.",
)
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    default=0,
    show_default=True,
    help="Seed of the random walk, of the noise, and of all that is added.",
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
    gps: tuple[float, float, float] | None,
    frame: list[float],
    landmarks: dict[str, Any] | None,
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

    To try fixes and landmarks without data:

    \b
        masat simulate manhattan --noise 0.05,0.05,0.02 --gps 0.05:2 --landmarks 200 -o world.g2o
        masat solve world.g2o -o map.g2o
    """  # noqa: D301
    options.check_outputs(None, out, truth, picture)
    for target in (out, truth):
        if target is not None:
            format_of(target)
    options.check_picture(picture)
    if false is not None and not noise:
        raise click.UsageError(
            "--false needs --noise: a loop closure is false if its residual is far beyond the noise"
        )
    if frame and gps is None:
        raise click.UsageError("--frame is the frame of --gps: give both")
    size = {name: n for name, n in (("nodes", nodes), ("edges", edges)) if n is not None}
    try:
        exact = WORLDS[world](**size, seed=seed)
        measured = perturb(exact, noise, seed=seed) if noise else exact
        false_count = bad_count = None
        if false is not None:
            measured, is_false = _spoiled(measured, *false, seed)
            false_count = int(is_false.sum())
        if gps is not None:
            fraction, sigma, bad = gps
            in_world = _frame(exact, frame)
            measured, is_bad = add_fixes(
                measured, fraction, sigma, bad=bad, frame=in_world, seed=seed
            )
            assert measured.poses is not None
            exact = exact.with_poses(measured.poses)
            bad_count = int(is_bad.sum())
        if landmarks is not None:
            measured = add_landmarks(measured, **landmarks, seed=seed)
            none = {"sigma": 0.0} | ({"sigma_bearing": 0.0} if "sigma_bearing" in landmarks else {})
            exact = add_landmarks(exact, **(landmarks | none), seed=seed)
    except MemoryError:
        raise MasatError("there is not enough memory for a world of this size") from None
    seen = measured.landmarks
    unplaced = None if seen is None else replace(seen, positions=None)
    write(replace(measured, poses=None, landmarks=unplaced), out)
    if truth is not None:
        write(exact, truth)
    if picture is not None:
        from masat.plotting import plot

        plot({f"{world}, truth": exact}, picture)
    counts = {"nodes": len(measured.ids), "edges": len(measured.edges), "false": false_count}
    fixes = 0 if measured.priors is None else len(measured.priors)
    if gps is not None:
        counts |= {"fixes": fixes, "bad_fixes": bad_count}
    if seen is not None:
        counts |= {"landmarks": len(seen), "observations": len(seen.observations)}
    if as_json:
        files = {"out": str(out), "truth": None if truth is None else str(truth)}
        show.as_json({"world": world, **files, **counts, "noise": noise, "seed": seed})
    elif not quiet:
        part = "" if false_count is None else f", {false_count} of them false loop closures"
        if gps is not None:
            part += f", {fixes} fixes" + (f", {bad_count} of them bad" if bad_count else "")
        if seen is not None:
            part += f", {len(seen)} landmarks with {len(seen.observations)} observations"
        click.echo(f"{out}: {counts['nodes']} nodes, {counts['edges']} edges{part}")
