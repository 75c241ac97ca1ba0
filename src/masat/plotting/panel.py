"""One graph in one panel: trajectory, loop closures, fixed nodes and the first node."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from masat.arrays import Flags, Floats, Ids
from masat.graph import PoseGraph
from masat.residuals import chi2_per_edge

if TYPE_CHECKING:
    from matplotlib.cm import ScalarMappable

# Dark blue and vermilion: with every kind of color blindness one is dark and the other light.
TRAJECTORY, CLOSURES = "#12436d", "#ed6a0f"
_MARKS = "#000000"
# Lines thinner than this (points) are drawn transparent instead.
_THINNEST = 0.15
_FAINTEST = 0.04
# Vector files with more edges than this are slow to open: their lines are stored as pixels.
_MOST_VECTORS = 20_000
_MANY_FIXED = 50
_MARGIN = 1.05
# The part of a panel that lines run through is counted in cells, at this many points of each line.
_CELLS, _SAMPLES = 64, 9


@dataclass(frozen=True)
class Style:
    """What all panels of a figure have in common.

    Attributes
    ----------
    color : ScalarMappable or None
        The scale of chi2, or None for one color a kind of edge.
    stride : int
        The first, and then each `stride`-th loop closure is drawn.
    points : float
        Side of a panel, in points (1/72 inch).
    radius : float or None
        Half of the meters that each panel shows, or None to fit each to its graph.
    """

    color: ScalarMappable | None
    stride: int
    points: float
    radius: float | None


class Panel:
    """A graph with poses, to be drawn."""

    def __init__(self, graph: PoseGraph) -> None:
        assert graph.poses is not None
        self.graph = graph
        self.positions: Floats = graph.poses[:, : graph.dimension]

    @cached_property
    def closures(self) -> Flags:
        """Which edges are loop closures, (m,)."""
        ends = self.graph.edge_indices
        closes: Flags = np.abs(ends[:, 0] - ends[:, 1]) != 1
        return closes

    @cached_property
    def radius(self) -> float:
        """Half of the largest extent, in meters, at least a millimeter."""
        return max(float(np.ptp(self.positions, axis=0).max()) / 2, 1e-3)

    def draw(self, ax: Any, title: str, axes: tuple[int, ...], style: Style) -> None:
        """Draw the graph into empty axes.

        Of a 3D graph the coordinates `axes` are drawn: two for a projection, three into 3D axes.
        """
        planar = self.graph.dimension == 2
        shown = self.positions if planar else self.positions[:, axes]
        names = "xy" if planar else "".join("xyz"[k] for k in axes)
        if len(names) == 3:
            ax.computed_zorder = False  # otherwise 3D axes guess what lies on top
        self._draw_edges(ax, shown, style)
        self._draw_marks(ax, shown)
        radius = _MARGIN * (style.radius or self.radius)
        _frame(ax, shown, names, radius, is_shared=style.radius is not None)
        ax.set_title(title, parse_math=False, pad=18)
        ax.annotate(
            self._caption(),
            (0.5, 1.0),
            (0, 5),
            xycoords="axes fraction",
            textcoords="offset points",
            ha="center",
            fontsize=8,
            color="0.3",
            annotation_clip=False,
        )

    def _caption(self) -> str:
        nodes, edges = len(self.graph.ids), len(self.graph.edges)
        if edges == 0:
            return f"{_count(nodes, 'node')}, no edges"
        # Loop closures between equal poses have no length: their number tells that they are there.
        closures = _count(int(self.closures.sum()), "loop closure")
        chi2 = float(chi2_per_edge(self.graph).sum())
        return f"{_count(nodes, 'node')}, {_count(edges, 'edge')} ({closures}), chi2 {chi2:.4g}"

    def _draw_edges(self, ax: Any, shown: Floats, style: Style) -> None:
        chosen = np.flatnonzero(self.closures)[:: style.stride]
        drawn = "" if style.stride == 1 else f" (1 in {style.stride} drawn)"
        chain = np.flatnonzero(~self.closures)
        if style.color is None:
            odometry = {"color": TRAJECTORY, "zorder": 2, "label": "odometry"}
            loops = {"color": CLOSURES, "zorder": 3, "label": f"loop closures{drawn}"}
            self._draw_lines(ax, shown, chain, style, ink=0.4, widest=1.2, **odometry)
            # Less ink, so that the trajectory shows through where there are many.
            self._draw_lines(ax, shown, chosen, style, ink=0.28, widest=0.5, **loops)
            return
        low, _ = style.color.get_clim()
        chi2 = np.maximum(chi2_per_edge(self.graph), low or 0.0)  # zero has no logarithm
        order = np.argsort(chi2, kind="stable")
        look = {"array": chi2[order], "cmap": style.color.cmap, "norm": style.color.norm}
        self._draw_lines(ax, shown, order, style, ink=0.5, widest=1.0, zorder=2, **look)

    def _draw_lines(
        self,
        ax: Any,
        shown: Floats,
        edges: Ids,
        style: Style,
        *,
        ink: float,
        widest: float,
        **look: Any,
    ) -> None:
        """Draw edges; `ink` is the fraction of the map's part of the panel that they may cover."""
        if len(edges) == 0:
            return
        segments = shown[self.graph.edge_indices[edges]]
        side = 2 * (style.radius or self.radius)
        length = float(np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1).sum()) / side
        width, alpha = stroke(length, ink * style.points * occupied(segments, side), widest)
        if shown.shape[1] == 3:
            from mpl_toolkits.mplot3d.art3d import Line3DCollection as Lines
        else:
            from matplotlib.collections import LineCollection as Lines
        lines = Lines(
            segments,
            linewidths=width,
            alpha=alpha,
            capstyle="butt",
            rasterized=len(self.graph.edges) > _MOST_VECTORS,
            **look,
        )
        if shown.shape[1] == 3:
            ax.add_collection3d(lines)
        else:
            ax.add_collection(lines, autolim=False)

    def _draw_marks(self, ax: Any, shown: Floats) -> None:
        fixed = self.graph.index(self.graph.fixed)
        if len(fixed):
            size = 5 if len(fixed) <= _MANY_FIXED else 2
            ax.plot(*shown[fixed].T, "s", color=_MARKS, markersize=size, zorder=4,
                    label="fixed node" if len(fixed) == 1 else "fixed nodes")  # fmt: skip
        ax.plot(*shown[:1].T, "o", markerfacecolor="white", markeredgecolor=_MARKS,
                markersize=6, zorder=5, label="first node")  # fmt: skip


def _count(number: int, noun: str) -> str:
    return f"{number:,} {noun}" + ("" if number == 1 else "s")


def stroke(length: float, area: float, widest: float) -> tuple[float, float]:
    """Return the width (points) and the alpha of lines that cover a given area in total.

    Parameters
    ----------
    length : float
        Total length of the lines, in sides of the panel.
    area : float
        Area to cover if no lines overlap, in sides of the panel times points.
    widest : float
        Largest width, in points.
    """
    wanted = area / max(length, 1e-9)
    width = min(max(wanted, _THINNEST), widest)
    return width, float(np.clip(wanted / width, _FAINTEST, 1.0))


def occupied(segments: Floats, side: float) -> float:
    """Return the fraction of a panel's 64 x 64 cells that segments, (k, 2, 2 or 3), run through.

    `side` is the side of the panel in meters. Of 3D segments the two longest axes count.
    """
    low = segments.min(axis=(0, 1))
    axes = np.sort(np.argsort(-np.ptp(segments, axis=(0, 1)), kind="stable")[:2])
    cells = np.zeros((_CELLS + 1, _CELLS + 1), np.bool_)
    for weight in np.linspace(0, 1, _SAMPLES):
        points = (1 - weight) * segments[:, 0, axes] + weight * segments[:, 1, axes]
        at = ((points - low[axes]) * (_CELLS / side)).astype(np.int64).clip(0, _CELLS)
        cells[at[:, 0], at[:, 1]] = True
    return min(float(cells.sum()) / _CELLS**2, 1.0)


def _frame(ax: Any, shown: Floats, names: str, radius: float, *, is_shared: bool) -> None:
    """Set limits and labels, with a meter as long on each axis."""
    low, high = shown.min(axis=0), shown.max(axis=0)
    middle, reach = (low + high) / 2, np.full(len(names), radius)
    if len(names) == 2:
        ax.set_aspect("equal")
    else:
        if not is_shared:
            # A cube around a long map would leave most of the panel empty.
            reach = np.maximum((high - low) / 2 * _MARGIN, 0.1 * radius)
        ax.set_box_aspect(tuple(reach), zoom=0.88)  # otherwise the label of z is cut off
        for axis, half in zip("xyz", reach, strict=True):
            ax.locator_params(axis, nbins=max(2, round(6 * half / reach.max())))
        # The longer horizontal axis runs across the picture.
        ax.view_init(elev=30, azim=-60 if reach[0] >= reach[1] else -30)
    # A projection along y shows x and z on the two axes that matplotlib calls x and y.
    for axis, name, center, half in zip("xyz", names, middle, reach, strict=False):
        ax.set(**{f"{axis}lim": (center - half, center + half), f"{axis}label": f"{name} [m]"})
