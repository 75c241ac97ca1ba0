"""The picture of an evaluation: a map over the truth, colored by its error."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from masat.evaluation import Evaluation
from masat.files import write_atomically
from masat.plotting.figures import picture_format

if TYPE_CHECKING:
    from masat.plotting.picture import Picture


def plot_evaluation(evaluation: Evaluation, path: Path) -> Picture:
    """Draw the aligned map over the truth, seen along its thinnest axis, and the errors below.

    Parameters
    ----------
    evaluation : Evaluation
        What `masat.evaluate` returns.
    path : Path
        File for the picture; the ending gives the format (.png, .pdf, .svg, .jpg).

    Returns
    -------
    matplotlib.figure.Figure
        The figure, which Jupyter displays. It is not registered with pyplot.
    """
    from masat.plotting.picture import Picture

    figure = Picture(figsize=(8, 10), dpi=120, layout="constrained")
    file_format = picture_format(path, figure)
    above, below = figure.subplots(2, 1, height_ratios=(4, 1))
    positions, true = evaluation.poses[:, :3], evaluation.truth[:, :3]
    first, second = np.sort(np.argsort(-np.ptp(true, axis=0), kind="stable")[:2])
    above.plot(true[:, first], true[:, second], color="0.6", linewidth=1, label="truth", zorder=1)
    error = evaluation.ate.translation
    dots = above.scatter(
        positions[:, first], positions[:, second], c=error, s=4, label="aligned map", zorder=2
    )
    above.set(aspect="equal", xlabel=f"{'xyz'[first]} [m]", ylabel=f"{'xyz'[second]} [m]")
    above.legend(frameon=False)
    figure.colorbar(dots, ax=above, label="distance from the truth [m]", shrink=0.7)
    below.plot(error, color="#12436d", linewidth=1)
    below.set(xlabel="pose", ylabel="distance [m]", ylim=(0, None))
    write_atomically(path, figure.encode(file_format))
    return figure
