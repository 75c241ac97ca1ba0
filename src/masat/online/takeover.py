"""The map that a review has found, in the place of one that has grown since."""

from __future__ import annotations

from typing import Any

import numpy as np

from masat import _core, lie
from masat.arrays import Ids
from masat.online.arrivals import Arrivals
from masat.online.contents import graph_of, roots_of
from masat.online.parts import undetermined_rows
from masat.online.review import Found, Snapshot, in_frame, kept_rows
from masat.online.sensor_rows import index_of, rows_of, with_rows
from masat.online.waiting import Waiting

_EDGES = ("edge_numbers", "edges", "measurements", "information")


def outcome_of(
    core: _core.OnlineMap,
    arrivals: Arrivals | None,
    waiting: Waiting,
    seen: Snapshot,
    found: Found,
) -> tuple[dict[str, Any], Arrivals | None, Waiting]:
    """Return the contents of a core's map after a review, and what is left out of it then.

    Parameters
    ----------
    core : OnlineMap
        The map now.
    arrivals : Arrivals, optional
        Its closures. Those that have arrived since the review began are as they were judged.
    waiting : Waiting
        The priors and observations that are not part of it.
    seen, found : Snapshot, Found
        What was reviewed, and what was found.
    """
    contents = core.contents()
    if arrivals is None or found.decision is None:
        return _with_poses(contents, found), arrivals, waiting
    arrivals, kept_then = arrivals.copy(), found.decision.kept
    assert seen.trusted is not None
    numbers = contents["edge_numbers"]
    released = np.isin(numbers, seen.numbers[seen.trusted & ~kept_then])
    arrivals.release({name: contents[name][released] for name in _EDGES}, core)
    rows = arrivals.rows["number"]
    before = arrivals.kept
    at = np.searchsorted(seen.numbers, rows).clip(max=max(len(seen.numbers) - 1, 0))
    kept = np.where(seen.numbers[at] == rows, kept_then[at], before) & arrivals.present
    stays = ~np.isin(numbers, rows[~kept])
    new = arrivals.edges(kept & ~before)
    arrivals.decide(kept)
    edges = {name: np.concatenate([contents[name][stays], new[name]]) for name in _EDGES}
    order = np.argsort(edges["edge_numbers"], kind="stable")
    contents |= {name: np.ascontiguousarray(edges[name][order]) for name in _EDGES}
    every = np.concatenate([rows_of(contents), waiting.rejected])
    doubted = seen.rows["number"][~kept_rows(seen, found.decision)]
    every["rejected"] = np.isin(every["number"], doubted)
    waiting = waiting.with_rejected(every[every["rejected"]])
    contents = with_rows(contents, every[~every["rejected"]])
    # Without the closures that are left out now, the other measurements may determine less.
    contents = _with_poses(contents, found)
    undetermined = undetermined_rows(contents)
    if undetermined.any():
        rows = rows_of(contents)
        waiting = waiting.with_waiting(rows[undetermined])
        contents = _with_poses(with_rows(contents, rows[~undetermined]), found)
    return contents, arrivals, waiting


def _with_poses(contents: dict[str, Any], found: Found) -> dict[str, Any]:
    """Return contents with what was found as poses; later nodes move with their neighbors."""
    ids: Ids = contents["ids"]
    graph = graph_of(contents)
    old = contents["poses"]
    moved = old.copy()
    if found.poses is not None and found.roots is not None:
        # A component may have been moved as a whole since.
        first = in_frame(found.poses, found.roots, old)
        moved[: len(first)] = first
        ends = contents["sensor_ends"]
        joined = np.concatenate(
            [index_of(graph.edges.ravel(), ids).reshape(-1, 2), ends[ends[:, 0] >= 0]]
        )
        older, newer = np.sort(joined, axis=1).T
        for k in range(len(first), len(moved)):
            # Most nodes were added to an older one.
            to = older[newer == k][:1]
            if len(to):
                moved[k] = lie.compose(moved[to], lie.between(old[to], old[k : k + 1]))[0]
    return contents | {"poses": moved, "linearized": moved, "roots": roots_of(graph, ids)}
