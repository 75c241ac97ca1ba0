"""Initial guesses of graphs with priors, landmarks or partial information.

Any initializer solves the edges of full information by themselves, each connected part (a body) in
a frame of its own. Then each body is moved as a whole onto what is known of it in the world, or
relative to bodies that are placed already; landmarks follow from their observations.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from masat import _core, lie
from masat.alignment import Matches, moved, rigid_motion
from masat.arrays import Flags, Floats, Ids, Indices
from masat.assembly import Assembly
from masat.determinacy import body_of_each_node, with_undetermined_kept
from masat.errors import InitializationError
from masat.graph import PoseGraph
from masat.information import isotropic_weights
from masat.optimizers.equations import normal_equations
from masat.optimizers.translations import solve_translations


def placed_assembly(
    assembly: Assembly, method: Callable[[PoseGraph], PoseGraph]
) -> tuple[Assembly, list[str], list[str]]:
    """Return the assembly with poses of all nodes, complete with what is not determined, and notes.

    The first notes are those of the guess, the others say what is not determined.

    Parameters
    ----------
    assembly : Assembly
        A graph with priors, landmarks or partial edges.
    method : callable
        The initializer of the edges of full information.
    """
    source = assembly.source
    assert assembly.graph.relative is not None
    guess = method(assembly.graph.relative)
    if guess.poses is None:
        raise InitializationError("the initial guess left the graph without poses")
    # How the parts of the full edges lie to each other is found here.
    notes = [n for n in guess.notes if n not in source.notes and "each placed in a frame" not in n]
    placing = _Placing(assembly, guess.poses)
    placing.run()
    complete, more = with_undetermined_kept(assembly.at(placing.poses))
    if placing.moved_as_one:
        # The first step of an optimizer improves the translations as much.
        return complete, notes, more
    return _with_better_translations(complete), notes, more


def given_assembly(assembly: Assembly) -> tuple[Assembly, list[str]]:
    """Return the assembly at the graph's own poses, landmarks without a position placed."""
    source = assembly.source
    if source.poses is None:
        raise InitializationError(
            "the graph has no poses of its own to start from: choose another initial guess"
        )
    if assembly.graph.poses is None:
        placing = _Placing(assembly, source.poses, everything_placed=True)
        placing.run()
        assembly = assembly.at(placing.poses)
    return with_undetermined_kept(assembly)


class _Placing:
    """The poses of all nodes, and which of them are placed in the frame of the world."""

    def __init__(
        self, assembly: Assembly, poses: Floats, *, everything_placed: bool = False
    ) -> None:
        self._assembly, graph = assembly, assembly.graph
        self._d = graph.dimension
        self.poses = assembly.placed(poses, assembly.source.points)
        self._bodies = body_of_each_node(assembly)
        self._is_point = assembly.is_point
        self._placed = np.zeros(len(graph.ids), np.bool_)
        self._placed[graph.index(graph.fixed)] = True
        if everything_placed:
            self._placed[assembly.poses_at] = True
        self._spread()
        ends = self._bodies[graph.edge_indices[: assembly.measured]]
        rows = np.flatnonzero(ends[:, 0] != ends[:, 1])
        weights = isotropic_weights(graph.information[rows])
        self._i, self._j = graph.edge_indices[rows].T
        self._z = graph.measurements[rows]
        self._offsets = None if graph.sensor_offsets is None else graph.sensor_offsets[rows]
        self._rotation = weights.rotation
        self._translation = _position_weights(graph.information[rows], weights.translation)

    @property
    def moved_as_one(self) -> bool:
        """Whether there is nothing but one body of poses."""
        bodies = self._bodies[self._assembly.poses_at]
        return not self._is_point.any() and bool((bodies == bodies[0]).all())

    def run(self) -> None:
        """Place one body after the other, those with the most matches first."""
        self._locate()
        waiting = ~self._placed & ~self._is_point
        while waiting.any():
            found = self._matches_by_body()
            if not found:
                # Nothing ties the rest to what is placed: its largest body stays where it is.
                sizes = np.bincount(self._bodies[waiting])
                self._placed |= self._bodies == int(np.argmax(sizes))
            else:
                enough = [b for b, m in found.items() if len(m.positions) >= self._d]
                for body in enough or [max(found, key=lambda b: _strength(found[b]))]:
                    own = (self._bodies == body) & ~self._is_point
                    self.poses = moved(self.poses, rigid_motion(found[body]), own)
                    self._placed |= own
            self._locate()
            waiting = ~self._placed & ~self._is_point
        self._guess_points()

    def _spread(self) -> None:
        """Count all poses of a body as placed if one is."""
        own = np.unique(self._bodies[self._placed])
        self._placed |= np.isin(self._bodies, own) & ~self._is_point

    def _matches_by_body(self) -> dict[int, Matches]:
        """Return what ties the bodies that wait to what is placed."""
        d = self._d
        i, j, z = self._i, self._j, self._z
        # The end that waits, and the other one, which is placed.
        ahead = self._placed[i] & ~self._placed[j] & ~self._is_point[j]
        behind = self._placed[j] & ~self._placed[i] & ~self._is_point[i]
        seen_from = lie.compose(self.poses[i], z)
        own_j = self._with_offsets(self.poses[j])
        body = np.concatenate([self._bodies[j[ahead]], self._bodies[i[behind]]])
        own = np.concatenate([own_j[ahead], seen_from[behind]])
        target = np.concatenate([seen_from[ahead], own_j[behind]])
        w_t = np.concatenate([self._translation[ahead], self._translation[behind]])
        w_r = np.concatenate([self._rotation[ahead], self._rotation[behind]])
        # What is measured of a rotation is that of the node, not that of the measurement.
        out = {}
        for b in np.unique(body[(w_t > 0) | (w_r > 0)]):
            p, r = (body == b) & (w_t > 0), (body == b) & (w_r > 0)
            out[int(b)] = Matches(
                own[p, :d],
                target[p, :d],
                w_t[p],
                _rotations(own[r]),
                _rotations(target[r]),
                w_r[r],
            )
        return out

    def _with_offsets(self, poses: Floats) -> Floats:
        if self._offsets is None:
            return poses
        return lie.compose(poses, self._offsets)

    def _locate(self) -> None:
        """Place the landmarks that placed nodes saw: the weighted mean of what they say."""
        seen = self._placed[self._i] & self._is_point[self._j] & ~self._placed[self._j]
        seen &= self._translation > 0
        self._average(np.flatnonzero(seen), self._translation)

    def _guess_points(self) -> None:
        """Place what landmarks are left where their partial observations say."""
        left = self._is_point[self._j] & ~self._placed[self._j]
        self._average(np.flatnonzero(left), np.ones(len(self._j)))

    def _average(self, rows: Ids, weights: Floats) -> None:
        if len(rows) == 0:
            return
        where = lie.compose(self.poses[self._i[rows]], self._z[rows])[:, : self._d]
        points, n, w = self._j[rows], len(self.poses), weights[rows]
        total = np.bincount(points, w, n)
        reached = total > 0
        for k in range(self._d):
            summed = np.bincount(points, w * where[:, k], n)
            self.poses[reached, k] = summed[reached] / total[reached]
        self._placed |= reached


def _strength(matches: Matches) -> tuple[int, float]:
    return (
        len(matches.positions) + len(matches.rotations),
        float(matches.position_weights.sum() + matches.rotation_weights.sum()),
    )


def _rotations(poses: Floats) -> Floats:
    return _core.rotation_matrices(np.ascontiguousarray(poses))


def _position_weights(information: Floats, isotropic: Floats) -> Floats:
    """Return weights of positions; a horizontal fix in 3D counts too, its height being a guess."""
    if information.shape[1] == 3:
        return isotropic
    open_ = np.flatnonzero(isotropic == 0)
    out = isotropic.copy()
    out[open_] = np.linalg.eigvalsh(information[open_, :3, :3])[:, 1].clip(min=0)
    return out


def note_of_components(graph: PoseGraph) -> list[str]:
    """Return a note if the graph has several components."""
    labels: Indices = graph.components
    count = int(labels.max()) + 1
    if count == 1:
        return []
    return [
        f"the graph has {count} components, each placed in a frame of its own: nothing measures "
        "how they lie to each other"
    ]


def _with_better_translations(assembly: Assembly) -> Assembly:
    """Return the assembly with the translations that fit the rotations, if chi2 is lower there."""
    graph = assembly.graph
    assert graph.poses is not None
    if not _free(assembly).any():
        return assembly
    try:
        poses = solve_translations(graph, graph.poses)
    except InitializationError:
        return assembly
    equations = normal_equations(graph, 1)
    lower = equations.chi2(poses) < equations.chi2(graph.poses)
    return assembly.at(poses) if lower else assembly


def _free(assembly: Assembly) -> Flags:
    graph = assembly.graph
    return ~np.isin(graph.ids, graph.fixed)
