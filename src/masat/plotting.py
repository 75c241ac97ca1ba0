"""Pictures of pose graphs."""

from __future__ import annotations

import io
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from masat.errors import GraphError
from masat.files import write_atomically
from masat.graph import PoseGraph
from masat.residuals import chi2_per_edge

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_TRAJECTORY = "#1f4e79"
_LOOPS = "#c8553d"
_PANEL = 5.0  # inches


def plot(
    graphs: PoseGraph | Mapping[str, PoseGraph],
    path: str | os.PathLike[str] | None = None,
    *,
    color_by_error: bool = False,
    columns: int = 3,
    dpi: int = 120,
) -> Figure:
    """Draw the trajectory and the loop closures of graphs side by side.

    Parameters
    ----------
    graphs : PoseGraph or mapping of title to PoseGraph
        Graphs with poses, each in a panel of its own, in meters, in 2D and 3D.
    path : path-like, optional
        Where to write the picture; the ending gives the format (.png, .pdf, .svg).
    color_by_error : bool
        Color every edge by its chi2, on one logarithmic scale for all panels.
    columns : int
        Panels in a row, each 5 inches wide.
    dpi : int
        Pixels an inch.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    GraphError
        If a graph has no poses.
    """
    from matplotlib.figure import Figure

    panels = {"": graphs} if isinstance(graphs, PoseGraph) else dict(graphs)
    for title, graph in panels.items():
        if graph.poses is None:
            raise GraphError(f"the graph {title!r} has no poses to draw: initialize it first")
    columns = min(columns, len(panels))
    rows = -(-len(panels) // columns)
    figure = Figure(figsize=(_PANEL * columns, _PANEL * rows), layout="constrained")
    color = _error_colors(panels) if color_by_error else None
    axes = []
    for k, (title, graph) in enumerate(panels.items(), 1):
        spatial = graph.dimension == 3
        ax = figure.add_subplot(rows, columns, k, projection="3d" if spatial else None)
        _draw(ax, graph, color)
        ax.set_title(title)
        axes.append(ax)
    if color is not None:
        figure.colorbar(color, ax=axes, label="chi2 of the edge", shrink=0.7)
    if path is not None:
        path = Path(path)
        buffer = io.BytesIO()
        figure.savefig(buffer, format=path.suffix[1:] or "png", dpi=dpi)
        write_atomically(path, buffer.getvalue())
    return figure


def _error_colors(panels: Mapping[str, PoseGraph]) -> Any:
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LogNorm

    costs = np.concatenate([chi2_per_edge(graph) for graph in panels.values()])
    positive = costs[costs > 0]
    high = float(np.quantile(positive, 0.999)) if len(positive) else 1.0
    return ScalarMappable(LogNorm(max(high, 1e-300) * 1e-4, max(high, 1e-300)), "viridis")


def _draw(ax: Any, graph: PoseGraph, color: Any) -> None:
    assert graph.poses is not None
    d = graph.dimension
    places = graph.poses[:, :d]
    ends = graph.edge_indices
    consecutive = np.abs(ends[:, 0] - ends[:, 1]) == 1
    if d == 3:
        from mpl_toolkits.mplot3d.art3d import Line3DCollection as Lines
    else:
        from matplotlib.collections import LineCollection as Lines

    def add(chosen: Any, width: float, alpha: float, **style: Any) -> None:
        lines = Lines(places[ends[chosen]], linewidths=width, alpha=alpha, capstyle="butt", **style)
        ax.add_collection(lines, autolim=False) if d == 2 else ax.add_collection3d(lines)

    if color is None:
        add(~consecutive, 0.4, 0.5 if len(ends) < 30000 else 0.25, colors=_LOOPS)
        add(consecutive, 0.8, 1.0, colors=_TRAJECTORY)
    else:
        cost = np.maximum(chi2_per_edge(graph), color.norm.vmin)
        for chosen, width in ((~consecutive, 0.4), (consecutive, 0.9)):
            add(chosen, width, 1.0, array=cost[chosen], cmap=color.cmap, norm=color.norm)
    low, high = places.min(axis=0), places.max(axis=0)
    middle, half = (low + high) / 2, 0.525 * max(float((high - low).max()), 1e-3)
    ax.set_xlim(middle[0] - half, middle[0] + half)
    ax.set_ylim(middle[1] - half, middle[1] + half)
    ax.set_xlabel("x [m]")
    ax.set_ylabel("y [m]")
    if d == 3:
        ax.set_zlim(middle[2] - half, middle[2] + half)
        ax.set_zlabel("z [m]")
        ax.set_box_aspect(None, zoom=0.9)  # or the z label is cut off
    ax.set_aspect("equal")
