"""The map that a review has found, in the place of one that has grown since."""

from __future__ import annotations

from typing import Any

import numpy as np

from masat import _core, lie
from masat.arrays import Ids
from masat.online.arrivals import Arrivals
from masat.online.files import graph_of, roots_of
from masat.online.review import PRIORS, Found, Snapshot, in_frame, with_priors
from masat.online.waiting_priors import WaitingPriors

_EDGES = ("edge_numbers", "edges", "measurements", "information")


def outcome_of(
    core: _core.OnlineMap,
    arrivals: Arrivals | None,
    waiting: WaitingPriors,
    seen: Snapshot,
    found: Found,
) -> tuple[dict[str, Any], Arrivals | None, WaitingPriors]:
    """Return the contents of a core's map after a review, and what is left out of it then.

    Parameters
    ----------
    core : OnlineMap
        The map now.
    arrivals : Arrivals, optional
        Its closures. Those that have arrived since the review began are as they were judged.
    waiting : WaitingPriors
        The priors that are not part of it.
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
    contents = with_priors(contents, waiting.rejected)
    doubted = seen.prior_numbers[~found.decision.kept_priors]
    stays = ~np.isin(contents["prior_numbers"], doubted)
    left_out = np.zeros(int((~stays).sum()), waiting.rows.dtype)
    left_out["rejected"] = True
    for name, field in PRIORS.items():
        left_out[field] = contents[name][~stays]
        contents[name] = np.ascontiguousarray(contents[name][stays])
    left_out["node"] = core.find_all(np.array(left_out["id"]))
    return _with_poses(contents, found), arrivals, waiting.with_rejected(left_out)


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
        added = np.argsort(graph.index(ids))
        older, newer = np.sort(added[graph.edge_indices], axis=1).T
        for k in range(len(first), len(moved)):
            # Most nodes were added to an older one.
            to = older[newer == k][:1]
            if len(to):
                moved[k] = lie.compose(moved[to], lie.between(old[to], old[k : k + 1]))[0]
    return contents | {"poses": moved, "linearized": moved, "roots": roots_of(graph, ids)}
