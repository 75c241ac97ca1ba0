"""Figures with one panel a graph."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from masat.arrays import Ids
from masat.errors import GraphError, MasatError
from masat.files import write_atomically
from masat.graph import PoseGraph
from masat.optimizers import Result
from masat.plotting.panel import CLOSURES_LABEL, REJECTED_LABEL, Panel, Style, radius_of
from masat.plotting.views import View, drawn_axes
from masat.residuals import chi2_per_edge

if TYPE_CHECKING:
    from matplotlib.cm import ScalarMappable

    from masat.plotting.picture import Picture

# Inches a panel: one or two panels get a larger share of a page that is about 12 inches wide.
_SMALLEST_PANEL, _LARGEST_PANEL, _PAGE = 5.0, 8.0, 12.0
# Above and below a panel: with less the edge of the picture cuts off the titles.
_PAD = 0.12


def plot(
    graphs: PoseGraph | Result | Mapping[str, PoseGraph | Result],
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

    The result of a robust solve gets two panels: the map with the loop closures that were kept, and
    its trajectory with the rejected ones, dashed.

    Parameters
    ----------
    graphs : PoseGraph, Result, or mapping of title to PoseGraph or Result
        Graphs with poses, or results. Each gets a panel with its title, its size and its chi2; axes
        are in meters.
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
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    from masat.plotting.picture import Picture

    panels = _panels(graphs)
    if not panels:
        raise GraphError("there is no graph to draw: the mapping of titles to graphs is empty")
    for title, graph, _ in panels:
        if graph.poses is None:
            raise GraphError(
                f"the graph {title!r} has no poses to draw: give it some with masat.initialize"
            )
    if columns < 1:
        raise MasatError(f"columns must be at least 1, got {columns}")
    columns = min(columns, len(panels))
    rows = -(-len(panels) // columns)
    size = float(np.clip(_PAGE / columns, _SMALLEST_PANEL, _LARGEST_PANEL))
    layout = ConstrainedLayoutEngine(h_pad=_PAD)
    figure = Picture(figsize=(size * columns, size * rows), dpi=dpi, layout=layout)
    file_format = "png" if path is None else picture_format(Path(path), figure)
    graphs_alone = [graph for _, graph, _ in panels]
    color = _error_scale(graphs_alone) if color_by_error else None
    style = Style(
        axes=drawn_axes([g for g in graphs_alone if g.dimension == 3], view),
        color=color,
        points=72 * size,
        radius=max(map(radius_of, graphs_alone)) if same_scale else None,
    )
    drawn = [Panel(graph, style, rejected) for _, graph, rejected in panels]
    axes = []
    for k, ((title, _, _), panel) in enumerate(zip(panels, drawn, strict=True), 1):
        projection = "3d" if panel.is_oblique else None
        ax = figure.add_subplot(rows, columns, k, projection=projection)
        panel.draw(ax, title)
        axes.append(ax)
    _legend(
        figure,
        axes,
        {
            CLOSURES_LABEL: {p.stride for p in drawn if p.rejected is None and len(p.closures)},
            REJECTED_LABEL: {p.stride for p in drawn if p.rejected is not None},
        },
    )
    if color is not None:
        figure.colorbar(color, ax=axes, label="chi2 of the edge", shrink=0.7)
    if path is not None:
        write_atomically(Path(path), figure.encode(file_format))
    return figure


def _panels(
    graphs: PoseGraph | Result | Mapping[str, PoseGraph | Result],
) -> list[tuple[str, PoseGraph, Ids | None]]:
    """Return title, graph and rejected loop closures, as pairs of ids, of each panel."""
    given = {"": graphs} if isinstance(graphs, PoseGraph | Result) else dict(graphs)
    panels: list[tuple[str, PoseGraph, Ids | None]] = []
    for title, shown in given.items():
        if isinstance(shown, PoseGraph):
            panels.append((title, shown, None))
            continue
        panels.append((title or "map", shown.graph, None))
        table = shown.closures
        if table is not None and not table["kept"].all():
            left_out = table[~table["kept"]]
            pairs = np.column_stack([left_out["from"], left_out["to"]])
            panels.append(("rejected loop closures", shown.graph, pairs))
    return panels


def picture_format(path: Path, figure: Picture) -> str:
    """Return the format of a picture by the ending of its file; an unknown one: MasatError."""
    chosen = path.suffix[1:].lower() or "png"
    known = figure.canvas.get_supported_filetypes()
    if chosen not in known:
        raise MasatError(f"{path}: no picture can be written as .{chosen}; known: {sorted(known)}")
    return chosen


def _error_scale(graphs: list[PoseGraph]) -> ScalarMappable:
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LogNorm

    chi2 = np.concatenate([chi2_per_edge(graph) for graph in graphs])
    positive = chi2[chi2 > 0]
    # One edge with a huge chi2 must not take the whole scale.
    high = float(np.quantile(positive, 0.999)) if len(positive) else 1.0
    high = max(high, 1e-300)
    return ScalarMappable(LogNorm(high * 1e-4, high), "viridis")


def _legend(figure: Picture, axes: list[Any], strides: dict[str, set[int]]) -> None:
    """Add one legend for all panels, below them, that tells if loop closures are left out."""
    entries: dict[str, Any] = {}
    for ax in axes:
        handles, labels = ax.get_legend_handles_labels()
        for handle, label in zip(handles, labels, strict=True):
            entries.setdefault(label, handle)
    labels = [name + _left_out(strides.get(name, {1})) for name in entries]
    legend = figure.legend(
        list(entries.values()),
        labels,
        loc="outside lower center",
        ncols=len(entries),
        frameon=False,
        fontsize=9,
    )
    for line, name in zip(legend.get_lines(), entries, strict=True):
        line.set_alpha(1.0)
        if name == REJECTED_LABEL:
            line.set_linestyle("dashed")
        if line.get_linestyle() != "None":
            line.set_linewidth(1.5)


def _left_out(strides: set[int]) -> str:
    """Return what the legend says if only some lines of a kind are drawn."""
    if len(strides) > 1:
        return " (not all drawn)"  # the caption of each panel tells how many
    stride = min(strides, default=1)
    return f" (1 in {stride} drawn)" if stride > 1 else ""
