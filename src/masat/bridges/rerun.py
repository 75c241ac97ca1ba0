"""rerun: a map and the iterations of its solve for rerun's viewer.

What `masat.view` draws becomes entities below "map", at the steps of the timeline "map": the graph
as it was, the iterations, the result. Positions are relative to the center of the map, since rerun
stores them in single precision. Maps in 2D lie in the plane z = 0.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from masat.arrays import AnyArray
from masat.bridges.packages import package
from masat.files import write_atomically
from masat.graph import PoseGraph
from masat.optimizers import Result
from masat.viewing.scene import scene_of

TIMELINE = "map"
# The colors of the page: those that color-blind people can tell apart.
_ODOMETRY, _CLOSURES, _REJECTED = (0x12, 0x43, 0x6D), (0xE0, 0x76, 0x1A), (0xC2, 0x00, 0x6B)
_PRIORS, _LANDMARKS, _TRUTH = (0x00, 0x7A, 0x5A), (0x6A, 0x3D, 0x9A), (0x4D, 0x4D, 0x4D)
_WIDTH, _POINT = 1.0, 2.0  # in pixels

_Points = NDArray[np.float32]


def log_map(
    shown: PoseGraph | Result,
    recording: Any = None,
    *,
    before: PoseGraph | Mapping[str, PoseGraph] | None = None,
    iterations: Iterable[ArrayLike] = (),
    truth: PoseGraph | None = None,
    title: str = "masat",
) -> None:
    """Log a map to a recording of rerun.

    Parameters
    ----------
    shown, before, iterations, truth, title
        As of `masat.view`.
    recording : rerun.RecordingStream, optional
        Where to log. Default: the active one, such as that of ``rerun.init("map", spawn=True)``.

    Raises
    ------
    GraphError
        If the graph has no poses, or if earlier maps have other nodes.
    MasatError
        If rerun is not installed.
    """
    rerun = package("rerun", "rerun")
    header, arrays = scene_of(
        shown,
        before={"before": before} if isinstance(before, PoseGraph) else before or {},
        iterations=iterations,
        truth=truth,
        covariances=False,
        title=title,
    )

    def log(name: str, what: Any, *, static: bool = False) -> None:
        rerun.log(name, what, static=static, recording=recording)

    def lines(ends: _Points, color: tuple[int, int, int]) -> Any:
        return rerun.LineStrips3D(ends, colors=[color], radii=rerun.Radius.ui_points(_WIDTH / 2))

    def dots(points: _Points, color: tuple[int, int, int]) -> Any:
        return rerun.Points3D(points, colors=[color], radii=rerun.Radius.ui_points(_POINT))

    log("map", rerun.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    log("about", rerun.TextDocument(_about(header)), static=True)
    kinds = (
        ("odometry", arrays["is_odometry"] & arrays["kept"], _ODOMETRY),
        ("closures", ~arrays["is_odometry"] & arrays["kept"], _CLOSURES),
        ("rejected", ~arrays["kept"], _REJECTED),
    )
    last = len(header["states"]) - 1
    for k, state in enumerate(header["states"]):
        rerun.set_time(TIMELINE, sequence=k, recording=recording)
        positions = _in_3d(arrays["positions"][k])
        log("map/nodes", dots(positions, _ODOMETRY))
        for name, which, color in kinds:
            if which.any():
                log(f"map/{name}", lines(positions[arrays["ends"][which]], color))
        log("step", rerun.TextLog(state))
        if header["chi2"][k] is not None:
            log("chi2_of_edges", rerun.Scalars(header["chi2"][k]))
        if k < last:
            continue
        for name, drawn, color in _others(arrays, positions):
            log(f"map/{name}", lines(drawn, color) if drawn.ndim == 3 else dots(drawn, color))


def save_rerun(
    shown: PoseGraph | Result, path: str | os.PathLike[str], *, title: str = "masat", **more: Any
) -> int:
    """Write a map as a file of rerun (.rrd), which ``rerun FILE`` opens.

    Parameters
    ----------
    shown, title, more
        As of `log_map`.
    path : path-like
        The file. It appears whole or not at all.

    Returns
    -------
    int
        Size of the file in bytes.
    """
    rerun = package("rerun", "rerun")
    recording = rerun.RecordingStream("masat")
    stream = recording.binary_stream()
    log_map(shown, recording, title=title, **more)
    data = stream.read()
    write_atomically(Path(path), data)
    return len(data)


def _others(
    arrays: Mapping[str, AnyArray], positions: _Points
) -> Iterable[tuple[str, _Points, tuple[int, int, int]]]:
    """Yield name, points (n, 3) or lines (n, 2, 3), and color of what goes with the result."""
    if "fixes" in arrays:
        fixes = _in_3d(arrays["fixes"])
        known = ~np.isnan(fixes).any(axis=1)
        yield "priors", fixes[known], _PRIORS
    if "landmarks" in arrays:
        points = _in_3d(arrays["landmarks"])
        poses, seen = arrays["observations"].T
        yield "landmarks", points, _LANDMARKS
        yield "observations", np.stack([positions[poses], points[seen]], axis=1), _LANDMARKS
    if "truth" in arrays:
        truth = _in_3d(arrays["truth"])
        ends = arrays["ends"][arrays["is_odometry"]]
        steps = truth[ends]
        yield "truth", steps[~np.isnan(steps).any(axis=(1, 2))], _TRUTH


def _in_3d(points: AnyArray) -> _Points:
    if points.shape[1] == 3:
        return points
    return np.column_stack([points, np.zeros(len(points), points.dtype)])


def _about(header: Mapping[str, Any]) -> str:
    center = ", ".join(f"{x:.6g}" for x in header["center"])
    facts = [f"{name}: {text}" for name, text in header["facts"]]
    return "\n".join([header["title"], *facts, f"center: {center} m", *header["notes"]])
