"""Times of nodes, float64 seconds or int64 nanoseconds, and the poses between them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from masat import _checks as checks
from masat import lie
from masat.arrays import Floats, Ids, Stamps
from masat.errors import GraphError

if TYPE_CHECKING:
    from masat.graph import PoseGraph

_UNITS = {"f": "seconds (floating-point numbers)", "i": "nanoseconds (integers)"}


def node_stamps(stamps: ArrayLike | None, ids: Ids) -> Stamps | None:
    """Return a copy of the stamps, one for each of the ids, in their order."""
    if stamps is None:
        return None
    given = _times("stamps", stamps)
    if given.shape != ids.shape:
        raise GraphError(
            f"stamps must have shape ({len(ids)},), one for each node, got {given.shape}"
        )
    for k in np.flatnonzero(~np.isfinite(given))[:1]:
        raise GraphError(f"the stamp of node {ids[k]} is not finite", node=int(k))
    return given


def joined_stamps(parts: Sequence[Stamps | None]) -> Stamps | None:
    """Return the stamps of nodes that come in parts, or None if a part has none."""
    given = [part for part in parts if part is not None]
    if len(given) < len(parts):
        return None
    kinds = [part.dtype.kind for part in given]
    for kind in kinds:
        if kind != kinds[0]:
            raise GraphError(
                f"stamps in {_UNITS[kinds[0]]} and in {_UNITS[kind]} cannot be joined: convert "
                "those of one graph, with `with_stamps`"
            )
    out: Any = np.concatenate(given)
    joined: Stamps = out
    return joined


def pose_at(
    graph: PoseGraph, t: ArrayLike, nodes: ArrayLike | None = None, max_gap: float | None = None
) -> Floats:
    """See `PoseGraph.pose_at`."""
    if graph.poses is None or graph.stamps is None:
        missing = "poses" if graph.poses is None else "stamps"
        raise GraphError(f"the graph has no {missing}, so there is no pose at a time")
    given = _times("the time", t)
    if graph.stamps.dtype.kind == "i" and given.dtype.kind == "f":
        raise GraphError(
            f"the stamps of the graph are in {_UNITS['i']}: give the time in the same unit"
        )
    typed: Any = given.astype(graph.stamps.dtype)
    wanted: Stamps = typed.ravel()
    chosen = np.arange(len(graph)) if nodes is None else graph.index(nodes).ravel()
    if len(chosen) == 0:
        raise GraphError("there is no node to interpolate between: `nodes` is empty")
    order = chosen[np.argsort(graph.stamps[chosen], kind="stable")]
    stamps = graph.stamps[order]
    _check_times(graph, order, wanted)
    # The last node at or before each time, and the one after it; the same at a node's stamp.
    before = np.searchsorted(stamps, wanted, side="right") - 1
    after = before + (stamps[before] < wanted)
    gap = _difference(stamps[after], stamps[before])
    if max_gap is not None:
        for k in np.flatnonzero(gap > max_gap)[:1]:
            a, b = before[k], after[k]
            raise GraphError(
                f"the time {wanted[k]} lies in a gap of {gap[k]:g} between node "
                f"{graph.ids[order[a]]} at {stamps[a]} and node {graph.ids[order[b]]} at "
                f"{stamps[b]}, more than max_gap={max_gap:g}"
            )
    _check_frames(graph, order[before], order[after], wanted)
    elapsed = _difference(wanted, stamps[before])
    fraction = np.divide(elapsed, gap, out=np.zeros(len(gap)), where=gap > 0)
    first, second = graph.poses[order[before]], graph.poses[order[after]]
    poses = np.where(gap[:, None] > 0, lie.interpolate(first, second, fraction), first)
    return poses.reshape(*given.shape, poses.shape[1])


def _times(name: str, values: ArrayLike) -> Stamps:
    """Return a copy of times: float64, or int64 if they are integers."""
    raw = np.asarray(values)
    if raw.dtype.kind in "iu":
        return checks.integers(name, values)
    return np.array(checks.numbers(name, values))


def _difference(later: Stamps, earlier: Stamps) -> Floats:
    """Return how much later times are; a difference of integers may need 64 bits without sign."""
    if later.dtype.kind == "i":
        return np.asarray((later - earlier).view(np.uint64), np.float64)
    return np.asarray(later - earlier, np.float64)


def _check_times(graph: PoseGraph, order: Ids, wanted: Stamps) -> None:
    """Refuse stamps that two nodes have, and times that are not between the first and the last."""
    assert graph.stamps is not None
    stamps = graph.stamps[order]
    for k in np.flatnonzero(stamps[1:] == stamps[:-1])[:1]:
        a, b = graph.ids[order[k : k + 2]]
        raise GraphError(
            f"the nodes {a} and {b} both have the stamp {stamps[k]}: choose the nodes of one "
            "trajectory with `nodes`"
        )
    # A time that is not a number is neither inside nor outside.
    inside = (wanted >= stamps[0]) & (wanted <= stamps[-1])
    for k in np.flatnonzero(~inside)[:1]:
        raise GraphError(
            f"the time {wanted[k]} is not between the first stamp, {stamps[0]}, and the last, "
            f"{stamps[-1]}: poses are not extrapolated"
        )


def _check_frames(graph: PoseGraph, before: Ids, after: Ids, wanted: Stamps) -> None:
    """Refuse to interpolate between components with frames of their own."""
    # A trajectory without edges is in one frame.
    if len(graph.edges) == 0:
        return
    component = graph.components
    has_own_frame = np.zeros(component.max() + 1, np.bool_)
    has_own_frame[component[graph.index(np.setdiff1d(graph.gauge, graph.fixed))]] = True
    a, b = component[before], component[after]
    for k in np.flatnonzero((a != b) & (has_own_frame[a] | has_own_frame[b]))[:1]:
        raise GraphError(
            f"the time {wanted[k]} is between the nodes {graph.ids[before[k]]} and "
            f"{graph.ids[after[k]]}, which no edges join: each is in a frame of its own; choose "
            "the nodes of one component with `nodes`"
        )
