"""The map that a review has found, in the place of one that has grown since."""

from __future__ import annotations

from typing import Any

import numpy as np

from masat import _core, lie
from masat.arrays import Floats, Ids
from masat.graph import PoseGraph
from masat.online.arrivals import Arrivals
from masat.online.files import first_of_components
from masat.online.review import Found, Snapshot

_EDGES = ("edge_numbers", "edges", "measurements", "information")


def taken_over(
    core: _core.OnlineMap, arrivals: Arrivals | None, seen: Snapshot, found: Found
) -> dict[str, Any]:
    """Return the contents of a core's map after a review, and take over what it decided.

    Parameters
    ----------
    core : OnlineMap
        The map now.
    arrivals : Arrivals, optional
        Its closures. Those that have arrived since are as they were judged.
    seen, found : Snapshot, Found
        What was reviewed, and what was found.
    """
    contents = core.contents()
    if arrivals is None or found.decision is None:
        return _with_poses(contents, found.poses)
    before, kept = arrivals.kept, arrivals.kept
    numbers = arrivals.rows["number"]
    at = np.searchsorted(seen.numbers, numbers).clip(max=max(len(seen.numbers) - 1, 0))
    known = seen.numbers[at] == numbers
    kept[known] = found.decision.kept[at[known]]
    kept &= arrivals.present
    stays = ~np.isin(contents["edge_numbers"], numbers[before & ~kept])
    new = arrivals.edges(kept & ~before)
    edges = {name: np.concatenate([contents[name][stays], new[name]]) for name in _EDGES}
    order = np.argsort(edges["edge_numbers"], kind="stable")
    arrivals.decide(kept)
    contents |= {name: np.ascontiguousarray(edges[name][order]) for name in _EDGES}
    return _with_poses(contents, found.poses)


def _with_poses(contents: dict[str, Any], poses: Floats | None) -> dict[str, Any]:
    """Return contents with other poses of the first nodes; later ones move with their neighbors."""
    ids: Ids = contents["ids"]
    graph = PoseGraph.from_arrays(*(contents[name] for name in _EDGES[1:]), ids=ids)
    old = contents["poses"]
    moved = old.copy()
    if poses is not None:
        moved[: len(poses)] = poses
        added = np.argsort(graph.index(ids))
        older, newer = np.sort(added[graph.edge_indices], axis=1).T
        for k in range(len(poses), len(moved)):
            # Most nodes were added to an older one.
            to = older[newer == k][:1]
            if len(to):
                moved[k] = lie.compose(moved[to], lie.between(old[to], old[k : k + 1]))[0]
    return contents | {
        "poses": moved,
        "linearized": moved,
        "roots": first_of_components(graph, ids),
    }
