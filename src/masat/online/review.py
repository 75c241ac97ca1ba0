"""A second look at a whole map that grows, on a thread of its own, while it grows on."""

from __future__ import annotations

import threading
from typing import Any, NamedTuple

import numpy as np

from masat import lie
from masat.arrays import AnyArray, Flags, Floats, Ids, Indices
from masat.assembly import needs_assembly
from masat.errors import MasatError
from masat.graph import PoseGraph
from masat.initializers import guess_of
from masat.online.contents import graph_of, poses_of_nodes, roots_of
from masat.online.sensor_rows import rows_of, with_rows
from masat.optimality.best import best_minimum
from masat.optimizers import optimize
from masat.optimizers.equations import normal_equations
from masat.robust import decide
from masat.robust.decision import Decision

# A fraction of chi2 by which another map has to be better.
_LOWER = 1e-3


class Snapshot(NamedTuple):
    """All that is known of a map at some moment.

    Attributes
    ----------
    graph : PoseGraph
        The map with all edges, also those that are not believed.
    ids : ndarray of int64, (n,)
        Ids of its poses and landmarks, in the order in which they were added.
    poses : ndarray, (n, 3) or (n, 7)
        Their poses, in the same order.
    trusted : ndarray of bool, (m,), or None
        Which edges are trusted; None if all are, so that nothing is decided.
    believed : ndarray of bool, (m,)
        Which edges are part of the map.
    numbers : ndarray of int64, (m,)
        The numbers of the edges, ascending.
    rows : structured ndarray, (k,)
        Priors and observations, in the order of their numbers.
    believed_rows : ndarray of bool, (k,)
        Which of these are part of the map.
    """

    graph: PoseGraph
    ids: Ids
    poses: Floats
    trusted: Flags | None
    believed: Flags
    numbers: Ids
    rows: AnyArray
    believed_rows: Flags


class Found(NamedTuple):
    """What a review found.

    Attributes
    ----------
    poses : ndarray, (n, 3) or (n, 7), or None
        Better poses, in the order of the snapshot; None if there are none.
    decision : Decision or None
        Which edges of the graph to believe.
    roots : ndarray of int32, (n,), or None
        Index of the node that stayed where it was, of each one's component; -1 if priors tie it.
    """

    poses: Floats | None
    decision: Decision | None
    roots: Indices | None = None


def snapshot(
    contents: dict[str, Any],
    withheld: dict[str, AnyArray] | None = None,
    doubtful: Ids | None = None,
    rejected: AnyArray | None = None,
) -> Snapshot:
    """Return what is known of a map.

    Parameters
    ----------
    contents : dict
        Contents of the core's map.
    withheld : dict, optional
        Edges that are not part of it, under the same names.
    doubtful : ndarray of int64, optional
        The numbers of all edges that are not trusted.
    rejected : structured ndarray, optional
        Priors and observations that are not part of it, as `Waiting` holds them.
    """
    parts = [contents] if withheld is None else [contents, withheld]
    names = ("edge_numbers", "edges", "measurements", "information")
    every = {name: np.concatenate([part[name] for part in parts]) for name in names}
    order = np.argsort(every["edge_numbers"], kind="stable")
    every = {name: values[order] for name, values in every.items()}
    numbers, rows = every["edge_numbers"], rows_of(contents)
    if rejected is not None:
        rows = np.concatenate([rows, rejected])
        rows = rows[np.argsort(rows["number"], kind="stable")]
    return Snapshot(
        graph_of(with_rows(contents, rows) | every),
        contents["ids"],
        contents["poses"],
        None if doubtful is None else ~np.isin(numbers, doubtful),
        np.isin(numbers, contents["edge_numbers"]),
        numbers,
        rows,
        np.isin(rows["number"], contents["sensor_numbers"]),
    )


def kept_rows(seen: Snapshot, decision: Decision) -> Flags:
    """Return which priors and observations of a snapshot a decision keeps."""
    is_prior = seen.rows["is_prior"]
    kept = np.ones(len(is_prior), np.bool_)
    if len(decision.measurements):
        kept[is_prior], kept[~is_prior] = decision.kept_priors, decision.kept_observations
    return kept


def look_again(seen: Snapshot) -> Found:
    """Decide on the edges of a map, and look for a better minimum of chi2."""
    graph, decision, is_same = seen.graph, None, True
    if seen.trusted is None:
        found = guess_of(graph, "auto")
    else:
        decision = decide(graph, seen.trusted, believed=seen.believed, threads=1)
        is_same = bool(
            (decision.kept == seen.believed).all()
            and (kept_rows(seen, decision) == seen.believed_rows).all()
        )
        graph = decision.believed(graph)
        found = graph.with_poses(decision.poses)
        if decision.points is not None:
            found = found.with_points(decision.points)
        if needs_assembly(found):
            found = optimize(found).graph
        else:
            equations = normal_equations(found, 1)
            found = found.with_poses(best_minimum(found, equations=equations).poses)
    if is_same and not found.chi2 < graph.chi2 * (1 - _LOWER):
        return Found(None, decision)
    assert found.poses is not None
    roots = roots_of(found, seen.ids)
    poses = in_frame(poses_of_nodes(found, seen.ids), roots, seen.poses)
    return Found(poses, decision, roots)


def in_frame(poses: Floats, roots: Indices, before: Floats) -> Floats:
    """Return poses moved so that the root of each component without priors is where it was.

    Parameters
    ----------
    poses : ndarray, (n, 3) or (n, 7)
    roots : ndarray of int, (n,)
        The index of the root of each one's component; -1 where priors tie it to the world.
    before : ndarray, (k, 3) or (k, 7)
        Where the first nodes were, all roots among them.
    """
    free = roots >= 0
    motion = lie.compose(before[roots[free]], lie.inverse(poses[roots[free]]))
    out = poses.copy()
    out[free] = lie.compose(motion, poses[free])
    return out


class Review:
    """A look that is taken while the map grows on.

    Parameters
    ----------
    seen : Snapshot
        The map as it is now.
    due : int
        The step at which the outcome is taken over, so that it does not depend on the machine.
    """

    def __init__(self, seen: Snapshot, due: int) -> None:
        self.seen, self.due = seen, due
        self._found: Found | None = None
        self._failed: BaseException | None = None
        # No daemon: the interpreter must not end while the core is at work.
        self._thread = threading.Thread(target=self._look, daemon=False)
        self._thread.start()

    def _look(self) -> None:
        try:
            self._found = look_again(self.seen)
        except MasatError:
            # Then the map stays as it is.
            self._found = Found(None, None)
        except BaseException as error:
            self._failed = error

    @property
    def is_ready(self) -> bool:
        """Whether `outcome` would not wait."""
        return not self._thread.is_alive()

    def outcome(self) -> Found:
        """Wait for the end, and return what was found."""
        self._thread.join()
        if self._failed is not None:
            raise self._failed
        assert self._found is not None
        return self._found
