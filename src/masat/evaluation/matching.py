"""Which poses of two maps belong together: by stamp or by node id."""

from __future__ import annotations

from typing import Literal, TypeAlias

import numpy as np

from masat.arrays import Floats, Ids, Stamps
from masat.errors import EvaluationError
from masat.graph import PoseGraph

Match: TypeAlias = Literal["auto", "stamps", "ids"]


def matched(
    graph: PoseGraph, truth: PoseGraph, match: Match, max_difference: float
) -> tuple[Ids, Ids, str]:
    """Return indices into both graphs of poses that belong together, and how they were found.

    By stamp, each pose of the map with fewer poses is matched with the pose of the other one whose
    stamp is closest, as evo does. The pairs are in the order of time, or of the ids.
    """
    stamped = graph.stamps is not None and truth.stamps is not None
    if match not in ("auto", "stamps", "ids"):
        raise EvaluationError(f'match must be "auto", "stamps" or "ids", got {match!r}')
    if match == "stamps" and not stamped:
        which = "the map" if graph.stamps is None else "the truth"
        raise EvaluationError(f"{which} has no stamps: match by node id instead (ids)")
    if match == "ids" or not stamped:
        _, own, other = np.intersect1d(graph.ids, truth.ids, return_indices=True)
        if len(own) == 0:
            raise EvaluationError("the map and the truth have no node id in common")
        return own, other, "ids"
    assert graph.stamps is not None
    assert truth.stamps is not None
    if not max_difference >= 0:
        raise EvaluationError(f"the largest difference of stamps is negative: {max_difference!r}")
    first, second = _in_seconds(graph.stamps, truth.stamps)
    if len(first) <= len(second):
        own, other = _nearest(first, second, max_difference)
    else:
        other, own = _nearest(second, first, max_difference)
    if len(own) == 0:
        raise EvaluationError(
            f"no stamps of the map and the truth are within {max_difference:g} s of each other: "
            f"the map is from {_span(graph.stamps)}, the truth from {_span(truth.stamps)}; allow "
            "a larger difference, or match by node id"
        )
    return own, other, "stamps"


def _nearest(few: Floats, many: Floats, max_difference: float) -> tuple[Ids, Ids]:
    """Return the indices of times that are close enough, in the order of the first."""
    first = np.argsort(few, kind="stable")
    order = np.argsort(many, kind="stable")
    t, sorted_many = few[first], many[order]
    after = np.searchsorted(sorted_many, t, side="right").clip(max=len(many) - 1)
    before = (after - 1).clip(min=0)
    is_after = np.abs(sorted_many[after] - t) < np.abs(t - sorted_many[before])
    best = np.where(is_after, after, before)
    close = np.abs(sorted_many[best] - t) <= max_difference
    return first[close], order[best[close]]


def _in_seconds(first: Stamps, second: Stamps) -> tuple[Floats, Floats]:
    """Return both in seconds; nanoseconds count from the earliest of all.

    A double holds each nanosecond of the 100 days after that.
    """
    if first.dtype.kind == second.dtype.kind == "i":
        zero = min(int(first.min()), int(second.min()))
        return _since(first, zero), _since(second, zero)
    return _seconds(first), _seconds(second)


def _since(stamps: Stamps, zero: int) -> Floats:
    # The difference may need 64 bits without a sign.
    elapsed = stamps.view(np.uint64) - np.array(zero, np.int64).view(np.uint64)
    return np.asarray(elapsed, np.float64) / 1e9


def _seconds(stamps: Stamps) -> Floats:
    seconds = np.asarray(stamps, np.float64)
    return seconds / 1e9 if stamps.dtype.kind == "i" else seconds


def _span(stamps: Stamps) -> str:
    seconds = _seconds(stamps)
    return f"{seconds.min():.9g} to {seconds.max():.9g} s"
