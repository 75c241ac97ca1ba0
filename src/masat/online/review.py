"""A second look at a whole map that grows, on a thread of its own, while it grows on."""

from __future__ import annotations

import threading
from typing import Any, NamedTuple

import numpy as np

from masat import lie
from masat.arrays import AnyArray, Flags, Floats, Ids
from masat.errors import MasatError
from masat.graph import PoseGraph
from masat.initializers.auto import auto
from masat.optimality.best import best_minimum
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
        Ids of its nodes, in the order in which they were added.
    poses : ndarray, (n, 3) or (n, 7)
        Their poses, in the same order.
    trusted : ndarray of bool, (m,), or None
        Which edges are trusted; None if all are, so that nothing is decided.
    believed : ndarray of bool, (m,)
        Which edges are part of the map.
    numbers : ndarray of int64, (m,)
        The numbers of the edges, ascending.
    """

    graph: PoseGraph
    ids: Ids
    poses: Floats
    trusted: Flags | None
    believed: Flags
    numbers: Ids


class Found(NamedTuple):
    """What a review found.

    Attributes
    ----------
    poses : ndarray, (n, 3) or (n, 7), or None
        Better poses, in the order of the snapshot; None if there are none.
    decision : Decision or None
        Which edges of the graph to believe.
    """

    poses: Floats | None
    decision: Decision | None


def snapshot(
    contents: dict[str, Any],
    withheld: dict[str, AnyArray] | None = None,
    doubtful: Ids | None = None,
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
    """
    parts = [contents] if withheld is None else [contents, withheld]
    numbers, edges, measurements, information = (
        np.concatenate([part[name] for part in parts])
        for name in ("edge_numbers", "edges", "measurements", "information")
    )
    order = np.argsort(numbers, kind="stable")
    numbers = numbers[order]
    graph = PoseGraph.from_arrays(
        edges[order],
        measurements[order],
        information[order],
        ids=contents["ids"],
        poses=contents["poses"],
    )
    trusted = None if doubtful is None else ~np.isin(numbers, doubtful)
    believed = np.isin(numbers, contents["edge_numbers"])
    return Snapshot(graph, contents["ids"], contents["poses"], trusted, believed, numbers)


def look_again(seen: Snapshot) -> Found:
    """Decide on the edges of a map, and look for a better minimum of chi2."""
    graph, decision, is_same = seen.graph, None, True
    if seen.trusted is None:
        found = auto(graph)
    else:
        decision = decide(graph, seen.trusted, believed=seen.believed, threads=1)
        is_same = bool((decision.kept == seen.believed).all())
        graph = decision.believed(graph)
        guess = graph.with_poses(decision.poses)
        found = guess.with_poses(best_minimum(guess, equations=normal_equations(guess, 1)).poses)
    if is_same and not found.chi2 < graph.chi2 * (1 - _LOWER):
        return Found(None, decision)
    assert found.poses is not None
    return Found(_in_frame(found.poses[found.index(seen.ids)], found, seen), decision)


def _in_frame(poses: Floats, found: PoseGraph, seen: Snapshot) -> Floats:
    """Return poses moved so that the first node of each component is where it was."""
    component = found.components[found.index(seen.ids)]
    _, first = np.unique(component, return_index=True)
    motion = lie.compose(seen.poses[first], lie.inverse(poses[first]))
    return lie.compose(motion[component], poses)


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
        self._thread = threading.Thread(target=self._look, daemon=True)
        self._thread.start()

    def _look(self) -> None:
        try:
            self._found = look_again(self.seen)
        except MasatError:
            # Then the map stays as it is.
            self._found = Found(None, None)
        except BaseException as error:
            self._failed = error

    def outcome(self) -> Found:
        """Wait for the end, and return what was found."""
        self._thread.join()
        if self._failed is not None:
            raise self._failed
        assert self._found is not None
        return self._found
