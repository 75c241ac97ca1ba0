"""Figures with one panel a graph."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from masat.errors import GraphError, MasatError
from masat.files import write_atomically
from masat.graph import PoseGraph
from masat.plotting.panel import Panel, Style, radius_of
from masat.plotting.views import View, drawn_axes
from masat.residuals import chi2_per_edge

if TYPE_CHECKING:
    from matplotlib.cm import ScalarMappable

    from masat.plotting.picture import Picture

# Inches a panel: one or two panels get a larger share of a page that is about 12 inches wide.
_SMALLEST_PANEL, _LARGEST_PANEL, _PAGE = 5.0, 8.0, 12.0


def plot(
    graphs: PoseGraph | Mapping[str, PoseGraph],
    path: str | os.PathLike[str] | None = None,
    *,
    color_by_error: bool = False,
    view: View = "auto",
    same_scale: bool = False,
    columns: int = 3,
    dpi: int = 120,
) -> Picture:
    """Draw the trajectory and the loop closures of graphs side by side.

    Edges between consecutive ids are drawn as odometry, all others as loop closures on top. Lines
    get thinner, and then more transparent, the more of them there are. Where loop closures would
    still hide all else, only every k-th is drawn; the legend and the line above the panel say so.

    Parameters
    ----------
    graphs : PoseGraph or mapping of title to PoseGraph
        Graphs with poses. Each gets a panel with its title, its size and its chi2; axes are in
        meters.
    path : path-like, optional
        File for the picture; the ending gives the format (.png, .pdf, .svg, .jpg).
    color_by_error : bool
        Color each edge by its chi2, on one logarithmic scale for all panels; edges with a larger
        chi2 are drawn on top, and all of them are drawn.
    view : {"auto", "top", "oblique"}
        How 3D graphs are seen. "top" projects along z. "oblique" is a view in perspective. "auto"
        projects nearly flat maps along their thinnest axis and shows all others obliquely.
    same_scale : bool
        Whether all panels show the same number of meters an inch. By default each panel is filled
        by its own graph.
    columns : int
        Panels in a row, each 5 to 8 inches wide.
    dpi : int
        Pixels an inch, of the picture and of its file.

    Returns
    -------
    matplotlib.figure.Figure
        The figure, which Jupyter displays. It is not registered with pyplot.

    Raises
    ------
    GraphError
        If there is no graph, or a graph has no poses.
    MasatError
        If the ending of `path` or `view` is unknown, or `columns` is less than 1.
    """
    from masat.plotting.picture import Picture

    panels = {"": graphs} if isinstance(graphs, PoseGraph) else dict(graphs)
    if not panels:
        raise GraphError("there is no graph to draw: the mapping of titles to graphs is empty")
    for title, graph in panels.items():
        if graph.poses is None:
            raise GraphError(
                f"the graph {title!r} has no poses to draw: give it some with masat.initialize"
            )
    if columns < 1:
        raise MasatError(f"columns must be at least 1, got {columns}")
    columns = min(columns, len(panels))
    rows = -(-len(panels) // columns)
    size = float(np.clip(_PAGE / columns, _SMALLEST_PANEL, _LARGEST_PANEL))
    figure = Picture(figsize=(size * columns, size * rows), dpi=dpi, layout="constrained")
    file_format = "png" if path is None else picture_format(Path(path), figure)
    color = _error_scale(panels) if color_by_error else None
    style = Style(
        axes=drawn_axes([g for g in panels.values() if g.dimension == 3], view),
        color=color,
        points=72 * size,
        radius=max(map(radius_of, panels.values())) if same_scale else None,
    )
    drawn = [Panel(graph, style) for graph in panels.values()]
    axes = []
    for k, (title, panel) in enumerate(zip(panels, drawn, strict=True), 1):
        projection = "3d" if panel.is_oblique else None
        ax = figure.add_subplot(rows, columns, k, projection=projection)
        panel.draw(ax, title)
        axes.append(ax)
    _legend(figure, axes, {panel.stride for panel in drawn if len(panel.closures)})
    if color is not None:
        figure.colorbar(color, ax=axes, label="chi2 of the edge", shrink=0.7)
    if path is not None:
        write_atomically(Path(path), figure.encode(file_format))
    return figure


def picture_format(path: Path, figure: Picture) -> str:
    """Return the format of a picture by the ending of its file; an unknown one: MasatError."""
    chosen = path.suffix[1:].lower() or "png"
    known = figure.canvas.get_supported_filetypes()
    if chosen not in known:
        raise MasatError(f"{path}: no picture can be written as .{chosen}; known: {sorted(known)}")
    return chosen


def _error_scale(panels: Mapping[str, PoseGraph]) -> ScalarMappable:
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LogNorm

    chi2 = np.concatenate([chi2_per_edge(graph) for graph in panels.values()])
    positive = chi2[chi2 > 0]
    # One edge with a huge chi2 must not take the whole scale.
    high = float(np.quantile(positive, 0.999)) if len(positive) else 1.0
    high = max(high, 1e-300)
    return ScalarMappable(LogNorm(high * 1e-4, high), "viridis")


def _legend(figure: Picture, axes: list[Any], strides: set[int]) -> None:
    """Add one legend for all panels, below them, that tells if loop closures are left out."""
    entries: dict[str, Any] = {}
    for ax in axes:
        handles, labels = ax.get_legend_handles_labels()
        for handle, label in zip(handles, labels, strict=True):
            entries.setdefault(label, handle)
    left_out = ""
    if strides != {1} and len(strides) == 1:
        left_out = f" (1 in {min(strides)} drawn)"
    elif len(strides) > 1:
        left_out = " (not all drawn)"  # the caption of each panel tells how many
    labels = [name + left_out if name == "loop closures" else name for name in entries]
    legend = figure.legend(
        list(entries.values()),
        labels,
        loc="outside lower center",
        ncols=len(entries),
        frameon=False,
        fontsize=9,
    )
    for line in legend.get_lines():
        line.set_alpha(1.0)
        if line.get_linestyle() != "None":
            line.set_linewidth(1.5)
