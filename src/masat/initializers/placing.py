"""Initial guesses of graphs with priors, landmarks or partial information.

Any initializer solves the edges of full information by themselves, each connected part (a body) in
a frame of its own. Then each body is moved as a whole onto what is known of it in the world, or
relative to bodies that are placed already; landmarks follow from their observations.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np

from masat import _core, lie
from masat.alignment import Matches, leveling_motion, rigid_motion
from masat.arrays import Flags, Floats, Ids
from masat.assembly import Assembly
from masat.determinacy import with_undetermined_kept
from masat.errors import InitializationError
from masat.freedoms import body_of_each_node
from masat.graph import PoseGraph
from masat.groups import Groups
from masat.information import isotropic_weights
from masat.initializers.roots import notes_of_components
from masat.initializers.waiting import WaitingBodies
from masat.optimizers.equations import normal_equations
from masat.optimizers.translations import solve_translations

# Cosine of the angle between axes that count as one.
_PARALLEL = 1 - 1e-6


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
    told = [*source.notes, *notes_of_components(assembly.graph.relative)]
    notes = [note for note in guess.notes if note not in told]
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
    """The poses of all nodes, and which of them are placed in the frame of the world.

    An edge between two bodies is looked at when its first end is placed, and never again.
    """

    def __init__(
        self, assembly: Assembly, poses: Floats, *, everything_placed: bool = False
    ) -> None:
        self._assembly, graph = assembly, assembly.graph
        self._d = graph.dimension
        self.poses = assembly.placed(poses, assembly.source.points)
        self._bodies = body_of_each_node(assembly)
        count = int(self._bodies.max()) + 1
        self._nodes_of = Groups(self._bodies, count)
        self._is_point = assembly.is_point
        self._placed = np.zeros(len(graph.ids), np.bool_)
        self._placed[graph.index(graph.fixed)] = True
        if everything_placed:
            self._placed[assembly.poses_at] = True
        # All poses of a body are placed if one is.
        own = self._nodes_of.of_all(np.unique(self._bodies[self._placed]))
        self._placed[own[~self._is_point[own]]] = True
        ends = self._bodies[graph.edge_indices[: assembly.measured]]
        rows = np.flatnonzero(ends[:, 0] != ends[:, 1])
        weights = isotropic_weights(graph.information[rows])
        self._i, self._j = graph.edge_indices[rows].T
        self._rows_of = Groups(np.concatenate([self._i, self._j]), len(graph.ids))
        self._z = graph.measurements[rows]
        self._offsets = None if graph.sensor_offsets is None else graph.sensor_offsets[rows]
        self._rotation = weights.rotation
        self._information = graph.information[rows]
        self._translation = _position_weights(self._information, weights.translation)
        self._waiting = WaitingBodies(count, self._d)

    @property
    def moved_as_one(self) -> bool:
        """Whether there is nothing but one body of poses."""
        bodies = self._bodies[self._assembly.poses_at]
        return not self._is_point.any() and bool((bodies == bodies[0]).all())

    def run(self) -> None:
        """Place one body after the other, those with the most matches first."""
        self._visit(np.flatnonzero(self._placed))
        sizes = np.bincount(self._bodies[~self._placed & ~self._is_point])
        largest = iter(np.argsort(-sizes, kind="stable"))
        left = np.count_nonzero(sizes)
        while left:
            bodies = self._waiting.take()
            if bodies:
                self._move(bodies)
            else:
                # Nothing places the rest: its largest body stays, but for heights that level it.
                bodies = [next(b for b in largest if not self._placed[self._nodes_of.of(b)[0]])]
                self._level(bodies[0])
            left -= len(bodies)
            nodes = self._nodes_of.of_all(np.array(bodies))
            self._placed[nodes] = True
            self._visit(nodes)
        self._guess_points()

    def _visit(self, nodes: Ids) -> None:
        """Follow the edges from nodes just placed: locate landmarks, and match the other bodies."""
        while len(nodes):
            rows = np.sort(self._rows_of.of_all(nodes) % max(len(self._i), 1))
            # Both ends of an edge may just have been placed.
            rows = rows[self._placed[self._i[rows]] != self._placed[self._j[rows]]]
            i, j = self._i[rows], self._j[rows]
            w_t, w_r, ahead = self._translation[rows], self._rotation[rows], self._placed[i]
            to_point = ahead & self._is_point[j]
            matching = ~to_point & ((w_t > 0) | (w_r > 0))
            body = self._bodies[np.where(ahead, j, i)]
            self._waiting.add(body[matching], rows[matching], w_t[matching], w_r[matching])
            nodes = self._locate(rows[to_point & (w_t > 0)], self._translation)

    def _move(self, bodies: list[int]) -> None:
        """Move bodies onto what edges from placed nodes say of them."""
        d = self._d
        rows_of_each = [self._waiting.rows[body] for body in bodies]
        body = np.repeat(np.arange(len(bodies)), [len(rows) for rows in rows_of_each])
        rows = np.concatenate(rows_of_each)
        behind = self._placed[self._j[rows]]
        order = np.lexsort((rows, behind, body))
        rows, behind = rows[order], behind[order][:, None]
        seen_from = lie.compose(self.poses[self._i[rows]], self._z[rows])
        sensor = self.poses[self._j[rows]]
        if self._offsets is not None:
            sensor = lie.compose(sensor, self._offsets[rows])
        own, target = np.where(behind, seen_from, sensor), np.where(behind, sensor, seen_from)
        w_t, w_r = self._translation[rows], self._rotation[rows]
        begins = np.searchsorted(body, np.arange(len(bodies) + 1))
        for k, (first, end) in enumerate(pairwise(begins)):
            p = first + np.flatnonzero(w_t[first:end] > 0)
            r = first + np.flatnonzero(w_r[first:end] > 0)
            motion = rigid_motion(
                Matches(
                    positions=own[p, :d],
                    targets=target[p, :d],
                    position_weights=w_t[p],
                    rotations=_rotations(own[r]),
                    target_rotations=_rotations(target[r]),
                    rotation_weights=w_r[r],
                )
            )
            nodes = self._nodes_of.of(bodies[k])
            self.poses[nodes] = lie.compose(motion, self.poses[nodes])

    def _level(self, body: int) -> None:
        """Level a body that placed nodes measure along one axis alone, as altitudes do."""
        d, nodes = self._d, self._nodes_of.of(body)
        rows = np.unique(self._rows_of.of_all(nodes) % max(len(self._i), 1))
        rows = rows[self._placed[self._i[rows]] & np.isin(self._j[rows], nodes)]
        values, vectors = np.linalg.eigh(self._information[rows][:, :d, :d])
        measured = values[:, -1] > 0
        rows, weights, own = rows[measured], values[measured, -1], vectors[measured, :, -1]
        if len(rows) == 0:
            return
        target = lie.compose(self.poses[self._i[rows]], self._z[rows])
        axes = np.einsum("kij,kj->ki", _rotations(target), own)
        axes *= np.sign(axes[np.arange(len(axes)), np.abs(axes).argmax(axis=1)])[:, None]
        along = axes @ axes[0] > _PARALLEL
        sensor = self.poses[self._j[rows]]
        if self._offsets is not None:
            sensor = lie.compose(sensor, self._offsets[rows])
        motion = leveling_motion(
            sensor[along, :d], axes[0], target[along, :d] @ axes[0], weights[along]
        )
        self.poses[nodes] = lie.compose(motion, self.poses[nodes])

    def _guess_points(self) -> None:
        """Place what landmarks are left where their partial observations say."""
        left = self._is_point[self._j] & ~self._placed[self._j]
        self._locate(np.flatnonzero(left), np.ones(len(self._j)))

    def _locate(self, rows: Ids, weights: Floats) -> Ids:
        """Place landmarks at the weighted mean of what edges say of them, and return them."""
        if len(rows) == 0:
            return rows
        where = lie.compose(self.poses[self._i[rows]], self._z[rows])[:, : self._d]
        points, own = np.unique(self._j[rows], return_inverse=True)
        total = np.bincount(own, weights[rows])
        for k in range(self._d):
            self.poses[points, k] = np.bincount(own, weights[rows] * where[:, k]) / total
        self._placed[points] = True
        return points


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
