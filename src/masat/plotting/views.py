"""From where 3D graphs are seen."""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

from masat.errors import MasatError
from masat.graph import PoseGraph

View = Literal["auto", "top", "oblique"]

# A map is flat if its thinnest extent is below this fraction of the next one: parking-garage, whose
# floors lie 12 m above each other on 260 m, is better seen from above than from the side.
_FLAT = 0.15


def drawn_axes(graphs: list[PoseGraph], view: View) -> tuple[int, ...]:
    """Return the coordinates of 3D graphs to draw: the same for all, so that they compare.

    Parameters
    ----------
    graphs : list of PoseGraph
        Graphs with poses.
    view : {"auto", "top", "oblique"}
        See `masat.plot`.

    Returns
    -------
    tuple of int
        Two coordinates for a projection along the third, or all three for an oblique view.

    Raises
    ------
    MasatError
        If the view is unknown.
    """
    if view not in get_args(View):
        raise MasatError(f"unknown view {view!r}; known: {', '.join(get_args(View))}")
    if view == "top":
        return (0, 1)
    if view == "auto" and graphs:
        thin = {_thin_axis(graph) for graph in graphs}
        if len(thin) == 1 and None not in thin:
            return tuple(k for k in range(3) if k not in thin)
    return (0, 1, 2)


def _thin_axis(graph: PoseGraph) -> int | None:
    """Return the axis along which the map is flat, or None."""
    assert graph.poses is not None
    extents = np.ptp(graph.poses[:, :3], axis=0)
    thin, middle, _ = np.argsort(extents, kind="stable")
    if extents[thin] > _FLAT * extents[middle]:
        return None
    # On a straight line two axes are thin, and z is the one to give up.
    return 2 if extents[2] <= _FLAT * extents.max() else int(thin)
