"""One graph in one panel: trajectory, loop closures, fixed nodes and the first node."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from masat.arrays import Floats, Ids
from masat.graph import PoseGraph
from masat.residuals import chi2_per_edge

if TYPE_CHECKING:
    from matplotlib.cm import ScalarMappable

# Dark blue and vermilion: with every kind of color blindness one is dark and the other light.
TRAJECTORY, CLOSURES = "#12436d", "#ed6a0f"
# Reddish purple, dashed: as light as the loop closures, which are in another panel.
REJECTED = "#d17ab3"
# Points of a dash and of the gap after it, however thin the line.
_DASH, _GAP = 4.0, 2.0
CLOSURES_LABEL, REJECTED_LABEL = "loop closures", "rejected loop closures"
_MARKS = "#000000"
# Which part of the cells that they run through lines may cover, and their largest width in points.
# Loop closures get less, so that the trajectory shows through where there are many.
_ODOMETRY_INK, _CLOSURES_INK, _CHI2_INK = (0.4, 1.2), (0.28, 0.5), (0.5, 1.0)
# Lines thinner than this (points) are drawn transparent instead, down to this alpha: fainter lines
# get wrong colors, since a picture has 256 shades.
_THINNEST, _FAINTEST = 0.15, 0.1
# More loop closures than this take seconds to draw and cannot be told apart.
_MOST_CLOSURES = 200_000
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
    axes : tuple of int
        Coordinates of 3D graphs to draw: two for a projection, three for an oblique view.
    color : ScalarMappable or None
        The scale of chi2, or None for one color a kind of edge.
    points : float
        Side of a panel, in points (1/72 inch).
    radius : float or None
        Half of the meters that each panel shows, or None to fit each to its graph.
    """

    axes: tuple[int, ...]
    color: ScalarMappable | None
    points: float
    radius: float | None


class Stroke(NamedTuple):
    """How lines are drawn.

    Attributes
    ----------
    width : float
        Width in points.
    alpha : float
        1 is opaque.
    stride : int
        Only every `stride`-th line may be drawn, otherwise even the faintest lines cover too much.
    """

    width: float
    alpha: float
    stride: int


def radius_of(graph: PoseGraph) -> float:
    """Return half of the largest extent of the poses, in meters, at least a millimeter."""
    assert graph.poses is not None
    return max(float(np.ptp(graph.poses[:, : graph.dimension], axis=0).max()) / 2, 1e-3)


class Panel:
    """A graph with poses, to be drawn in axes of its own.

    Parameters
    ----------
    graph : PoseGraph
        The graph.
    style : Style
        What all panels have in common.
    rejected : ndarray of int64, (k, 2), optional
        Ids of the nodes that rejected loop closures join. If given, these are drawn instead of the
        loop closures of the graph.
    """

    def __init__(self, graph: PoseGraph, style: Style, rejected: Ids | None = None) -> None:
        assert graph.poses is not None
        axes = (0, 1) if graph.dimension == 2 else style.axes
        self.graph = graph
        self.style = style
        self.names = "".join("xyz"[k] for k in axes)
        self.is_oblique = len(axes) == 3
        self.radius = style.radius or radius_of(graph)
        self.positions: Floats = graph.poses[:, axes]
        ends = graph.edge_indices
        is_odometry = np.abs(ends[:, 0] - ends[:, 1]) == 1
        self.odometry: Ids = ends[is_odometry].astype(np.int64)
        self.rejected = rejected
        self.closures: Ids = ends[~is_odometry].astype(np.int64)
        if rejected is not None:
            self.closures = graph.index(rejected)

    @cached_property
    def stride(self) -> int:
        """Every `stride`-th loop closure is drawn: all of them, unless they would hide all else.

        Colored by chi2 all are drawn, since the few with a large chi2 are looked for.
        """
        if (self.style.color is not None and self.rejected is None) or len(self.closures) == 0:
            return 1
        too_many = math.ceil(len(self.closures) / _MOST_CLOSURES)
        return max(self._stroke(self.closures, *_CLOSURES_INK).stride, too_many)

    def draw(self, ax: Any, title: str) -> None:
        """Draw the graph into empty axes, which are three-dimensional for an oblique view."""
        if self.is_oblique:
            ax.computed_zorder = False  # otherwise 3D axes guess what lies on top
        self._draw_edges(ax)
        self._draw_marks(ax)
        self._frame(ax)
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
        closures = _count(len(self.closures), "loop closure")
        if self.rejected is not None:
            kept = len(self.graph.edges) - len(self.odometry)
            closures = (
                f"{len(self.closures):,} of {_count(len(self.closures) + kept, 'loop closure')}"
            )
        if self.stride > 1:
            closures += f", 1 in {self.stride} drawn"
        if self.rejected is not None:
            return closures
        chi2 = float(chi2_per_edge(self.graph).sum())
        return f"{_count(nodes, 'node')}, {_count(edges, 'edge')} ({closures}), chi2 {chi2:.4g}"

    def _draw_edges(self, ax: Any) -> None:
        color = self.style.color
        if color is None or self.rejected is not None:
            chosen = self.closures[:: self.stride]
            odometry: dict[str, Any] = {"color": TRAJECTORY, "zorder": 2, "label": "odometry"}
            loops: dict[str, Any] = {"color": CLOSURES, "zorder": 3, "label": CLOSURES_LABEL}
            if self.rejected is not None:
                loops |= {"color": REJECTED, "label": REJECTED_LABEL, "linestyle": "dashed"}
            self._draw_lines(ax, self.odometry, *_ODOMETRY_INK, **odometry)
            self._draw_lines(ax, chosen, *_CLOSURES_INK, **loops)
            return
        low, _ = color.get_clim()
        chi2 = np.maximum(chi2_per_edge(self.graph), low or 0.0)  # zero has no logarithm
        order = np.argsort(chi2, kind="stable")
        every = self.graph.edge_indices[order].astype(np.int64)
        look: dict[str, Any] = {"array": chi2[order], "cmap": color.cmap, "norm": color.norm}
        self._draw_lines(ax, every, *_CHI2_INK, zorder=2, **look)

    def _draw_lines(self, ax: Any, edges: Ids, ink: float, widest: float, **look: Any) -> None:
        """Draw lines between pairs of indices of nodes, (k, 2)."""
        if len(edges) == 0:
            return
        if self.is_oblique:
            from mpl_toolkits.mplot3d.art3d import Line3DCollection as Lines
        else:
            from matplotlib.collections import LineCollection as Lines
        width, alpha, _ = self._stroke(edges, ink, widest)
        if look.get("linestyle") == "dashed":
            # A pattern is given in widths of the line.
            look["linestyle"] = (0, (_DASH / width, _GAP / width))
        lines = Lines(
            self.positions[edges],
            linewidths=width,
            alpha=alpha,
            capstyle="butt",
            rasterized=len(self.graph.edges) > _MOST_VECTORS,
            **look,
        )
        if self.is_oblique:
            ax.add_collection3d(lines)
        else:
            ax.add_collection(lines, autolim=False)

    def _stroke(self, edges: Ids, ink: float, widest: float) -> Stroke:
        """Return how to draw edges that may cover a part `ink` of the cells they run through."""
        segments = self.positions[edges]
        side = 2 * self.radius
        length = float(np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1).sum()) / side
        return stroke(length, ink * self.style.points * occupied(segments, side), widest)

    def _draw_marks(self, ax: Any) -> None:
        fixed = self.graph.index(self.graph.fixed)
        if len(fixed):
            size = 5 if len(fixed) <= _MANY_FIXED else 2
            ax.plot(*self.positions[fixed].T, "s", color=_MARKS, markersize=size, zorder=4,
                    label="fixed node" if len(fixed) == 1 else "fixed nodes")  # fmt: skip
        ax.plot(*self.positions[:1].T, "o", markerfacecolor="white", markeredgecolor=_MARKS,
                markersize=6, zorder=5, label="first node")  # fmt: skip

    def _frame(self, ax: Any) -> None:
        """Set limits and labels, with a meter as long on each axis."""
        low, high = self.positions.min(axis=0), self.positions.max(axis=0)
        middle = (low + high) / 2
        reach = np.full(len(self.names), _MARGIN * self.radius)
        if not self.is_oblique:
            ax.set_aspect("equal")
        else:
            if self.style.radius is None:
                # A cube around a long map would leave most of the panel empty.
                reach = np.maximum(_MARGIN * (high - low) / 2, 0.1 * self.radius)
            ax.set_box_aspect(tuple(reach), zoom=0.88)  # otherwise the label of z is cut off
            for axis, half in zip("xyz", reach, strict=True):
                ax.locator_params(axis, nbins=max(2, round(6 * half / reach.max())))
            # The longer horizontal axis runs across the picture.
            ax.view_init(elev=30, azim=-60 if reach[0] >= reach[1] else -30)
        # A projection along y shows x and z on the two axes that matplotlib calls x and y.
        for axis, name, center, half in zip("xyz", self.names, middle, reach, strict=False):
            ax.set(**{f"{axis}lim": (center - half, center + half), f"{axis}label": f"{name} [m]"})


def _count(number: int, noun: str) -> str:
    return f"{number:,} {noun}" + ("" if number == 1 else "s")


def stroke(length: float, area: float, widest: float) -> Stroke:
    """Return how to draw lines that cover a given area in total.

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
    alpha = min(wanted / width, 1.0)
    stride = max(1, math.ceil(_FAINTEST / alpha * (1 - 1e-9)))
    return Stroke(width, max(alpha, _FAINTEST), stride)


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
