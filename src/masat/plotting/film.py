"""Films of maps that grow."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from masat.arrays import Floats, Ids
from masat.errors import MasatError
from masat.files import write_atomically

_WRITERS = {".gif": "pillow", ".mp4": "ffmpeg"}
_FRAMES_PER_SECOND = 15
_MARGIN = 0.05


def check_film(path: Path) -> None:
    """Refuse a film that cannot be written, by its suffix or for lack of a program."""
    from matplotlib import animation

    writer = _WRITERS.get(path.suffix.lower())
    if writer is None:
        raise MasatError(f"{path}: a film is a .gif or a .mp4")
    if not animation.writers.is_available(writer):
        raise MasatError(f"{path}: {writer} is not installed, which writes {path.suffix}: use .gif")


def write_film(frames: list[tuple[Floats, Ids]], path: Path) -> None:
    """Write a film of poses from above, odometry in blue and loop closures in orange.

    Parameters
    ----------
    frames : list of (ndarray, ndarray)
        Poses, (n, 3) or (n, 7), and pairs of their indices that edges join, (m, 2), of each frame.
    path : Path
        A .gif, or a .mp4 where ffmpeg is installed.
    """
    from matplotlib import animation
    from matplotlib.collections import LineCollection
    from matplotlib.figure import Figure

    check_film(path)
    figure = Figure(figsize=(6, 6), layout="constrained")
    axes: Any = figure.add_subplot()
    axes.set_aspect("equal")
    last = np.concatenate([poses[:, :2] for poses, _ in frames])
    low, high = last.min(axis=0), last.max(axis=0)
    margin = _MARGIN * float((high - low).max() or 1.0)
    axes.set_xlim(low[0] - margin, high[0] + margin)
    axes.set_ylim(low[1] - margin, high[1] + margin)
    lines = [
        axes.add_collection(LineCollection([], colors=color, linewidths=width))
        for color, width in (("tab:orange", 0.5), ("tab:blue", 0.9))
    ]
    (robot,) = axes.plot([], [], "o", color="black", markersize=4)

    def draw(frame: int) -> list[Any]:
        poses, pairs = frames[frame]
        odometry = np.abs(np.diff(pairs, axis=1))[:, 0] == 1
        for line, which in zip(lines, (~odometry, odometry), strict=True):
            line.set_segments(list(poses[pairs[which]][:, :, :2]))
        robot.set_data(poses[-1:, 0], poses[-1:, 1])
        axes.set_title(f"{len(poses)} poses")
        return [*lines, robot]

    film = animation.FuncAnimation(figure, draw, frames=len(frames), blit=False)
    with TemporaryDirectory() as folder:
        whole = Path(folder) / path.name
        film.save(whole, writer=_WRITERS[path.suffix.lower()], fps=_FRAMES_PER_SECOND)
        write_atomically(path, whole.read_bytes())
