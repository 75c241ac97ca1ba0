"""`masat evaluate`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
import numpy as np

from masat.cli import options, show
from masat.evaluation import Evaluation, PoseErrors
from masat.evaluation import evaluate as evaluated
from masat.formats import FORMATS


@click.command(epilog="Example:  masat evaluate map.g2o groundtruth.tum")
@click.argument("file", metavar="MAP", type=click.Path(path_type=Path))
@click.argument("truth", type=click.Path(path_type=Path))
@click.option(
    "--align",
    type=click.Choice(["se3", "sim3", "origin", "none"]),
    default="se3",
    show_default=True,
    help="How MAP is moved onto TRUTH before: the best rigid motion, the best one with a scale, "
    "the first pose onto the first, or not at all.",
)
@click.option(
    "--match",
    type=click.Choice(["auto", "stamps", "ids"]),
    default="auto",
    show_default=True,
    help="How poses are matched: by stamp, or by node id. 'auto' takes the stamps if both files "
    "have some.",
)
@click.option(
    "--max-difference",
    type=click.FloatRange(min=0),
    default=0.01,
    show_default=True,
    metavar="SECONDS",
    help="Largest difference of the stamps of two matched poses.",
)
@click.option(
    "--delta",
    type=click.FloatRange(min=0, min_open=True),
    default=1.0,
    show_default=True,
    help="How far apart the two poses are between which a motion is compared, for the RPE.",
)
@click.option(
    "--unit",
    type=click.Choice(["frames", "meters"]),
    default="frames",
    show_default=True,
    help="Unit of --delta: poses, or meters along the path.",
)
@click.option(
    "--all-pairs", is_flag=True, help="Compare the motion from each pose on; they overlap."
)
@click.option(
    "--format",
    "file_format",
    type=click.Choice(list(FORMATS)),
    help="Format of MAP.  [default: recognized by its content]",
)
@click.option(
    "--truth-format",
    type=click.Choice(list(FORMATS)),
    help="Format of TRUTH.  [default: recognized by its content]",
)
@click.option(
    "--plot",
    "picture",
    type=click.Path(path_type=Path),
    help="Picture of the aligned map over the truth.",
)
@options.output
def evaluate(
    file: Path,
    truth: Path,
    align: Any,
    match: Any,
    max_difference: float,
    delta: float,
    unit: Any,
    all_pairs: bool,
    file_format: str | None,
    truth_format: str | None,
    picture: Path | None,
    as_json: bool,
    quiet: bool,
) -> None:
    """Compare the poses in MAP with those in TRUTH: ATE and RPE, by the definitions of evo.

    Both are graphs, trajectories or saved results. ATE are the errors of the poses after the
    alignment, RPE those of the motions between pairs of poses.
    """
    options.check_outputs(file, picture)
    options.check_outputs(truth, picture)
    options.check_picture(picture)
    # Edges do not count here, so neither does their information.
    estimate, true = (
        options.load(path, form, "identity", quiet)
        for path, form in ((file, file_format), (truth, truth_format))
    )
    found = evaluated(
        estimate,
        true,
        align=align,
        match=match,
        max_difference=max_difference,
        delta=delta,
        unit=unit,
        all_pairs=all_pairs,
    )
    if picture is not None:
        from masat.plotting import plot_evaluation

        plot_evaluation(found, picture)
    if as_json:
        show.as_json({"file": str(file), "truth": str(truth), **found.to_dict()})
    elif not quiet:
        options.notes(found.notes)
        _print(found)


def _print(found: Evaluation) -> None:
    aligned = {
        "none": "nothing",
        "origin": "the first pose",
        "se3": "a rigid motion",
        "sim3": f"a rigid motion and the scale {found.scale:.6g}",
    }
    by = {"stamps": "stamp", "ids": "node id"}[found.matched_by]
    show.rows(
        [("poses", f"{len(found.ids)}, matched by {by}"), ("aligned by", aligned[found.align])]
    )
    unit = found.unit if found.delta != 1 else found.unit.removesuffix("s")
    relative = f"RPE, {found.delta:g} {unit}"
    show.table(
        ("error", "rmse", "mean", "median", "std", "min", "max"),
        [*_rows("ATE", found.ate), *_rows(relative, found.rpe)],
    )


def _rows(name: str, errors: PoseErrors) -> list[list[str]]:
    """Return a row of the table for each kind of error; angles are shown in degrees."""
    shown = {"translation": ("m", 1.0), "rotation": ("deg", np.degrees(1.0)), "full": ("-", 1.0)}
    return [
        [f"{name}, {kind} ({unit})", *(show.number(value * factor) for value in values.values())]
        for (kind, values), (unit, factor) in zip(
            errors.statistics().items(), shown.values(), strict=True
        )
    ]
