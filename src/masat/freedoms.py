"""What the measurements of a graph leave undetermined, by node and direction.

Nodes that full measurements join move as one body. Between the bodies, and between them and what is
fixed, the other measurements are linearized at the poses. Directions in which a body can move at no
cost are undetermined: an edge from the world that measures just these, at the pose where the node
is, makes the system regular and changes neither the minimum nor chi2.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from masat import _core
from masat.arrays import Flags, Floats, Indices
from masat.assembly import Assembly, assemble, needs_assembly
from masat.graph import PoseGraph
from masat.groups import Groups
from masat.information import measured_directions
from masat.residuals import range_bearing_by_position, residuals
from masat.structure import eliminate

# What is added to the diagonal of the scaled system, and the variance above which a direction
# counts as undetermined: its information is below 1e-10 of that of the other directions.
_DAMPING, _UNDETERMINED = 1e-12, 1e10
# Lengths of unit directions below which they count as zero.
_ZERO = 1e-5
_MAX_ROUNDS = 20


class Freedom(NamedTuple):
    """What one body can do at no cost.

    Attributes
    ----------
    node : int
        Index of its node of smallest id.
    size : int
        Number of its nodes.
    translations : ndarray, (a, d)
        Undetermined directions of translation, in the world's frame.
    rotations : ndarray, (b, 1) or (b, 3)
        Undetermined axes of rotation, in the world's frame; in 2D [1].
    exact : bool
        Whether chi2 does not change however far the body moves so: a single measurement ties it.
        Else it may change a little beyond first order.
    """

    node: int
    size: int
    translations: Floats
    rotations: Floats
    exact: bool


def undetermined(assembly: Assembly) -> list[Freedom]:
    """Return what is undetermined at the poses of an assembly, the largest bodies first."""
    graph = assembly.graph
    assert graph.poses is not None
    bodies = body_of_each_node(assembly)
    fixed = np.zeros(int(bodies.max()) + 1, np.bool_)
    fixed[bodies[graph.index(graph.fixed)]] = True
    if fixed.all():
        return []
    system = _Bodies(assembly, bodies, fixed)
    found: list[Freedom] = []
    for _ in range(_MAX_ROUNDS):
        added = system.freedoms()
        if not added:
            break
        found += added
        system.keep(added)
    return sorted(found, key=lambda freedom: (-freedom.size, freedom.node))


def body_of_each_node(assembly: Assembly) -> Indices:
    """Return the body of each node: what edges of full information join, the world apart."""
    relative = assembly.graph.relative
    assert relative is not None
    # Landmarks and the world are bodies of their own. Each body is named by its first node first.
    named = np.arange(len(assembly.graph.ids))
    at, components = assembly.poses_at, relative.structure.components
    first = np.empty(int(components.max(initial=-1)) + 1, np.int64)
    first[components[::-1]] = np.arange(len(components))[::-1]
    named[at] = at[first[components]]
    is_name = np.zeros(len(named), np.bool_)
    is_name[named] = True
    bodies: Indices = (np.cumsum(is_name) - 1)[named].astype(np.int32)
    return bodies


def degrees_of_freedom(graph: PoseGraph) -> int:
    """Return the number of measured values minus the number of unknown ones that they determine.

    What nothing determines is found at the poses of the graph. Without poses, only landmarks that
    nothing measures are left out.
    """
    values = measured_directions(graph.information)
    if graph.priors is not None:
        values += measured_directions(graph.priors.information)
    if graph.landmarks is not None:
        values += measured_directions(graph.landmarks.information)
    unknown = graph.dof * (len(graph.ids) - len(graph.gauge))
    if not needs_assembly(graph):
        return values - unknown
    assembly = assemble(graph)
    unknown += graph.dimension * (len(graph.point_ids) - len(unmeasured_landmarks(assembly)))
    if assembly.graph.poses is not None:
        found = undetermined(assembly)
        unknown -= sum(len(each.translations) + len(each.rotations) for each in found)
    return values - unknown


def unmeasured_landmarks(assembly: Assembly) -> Indices:
    """Return the indices of landmarks without observation or prior, which solvers do not move."""
    fixed = np.isin(assembly.graph.ids, assembly.graph.fixed)
    return np.flatnonzero(fixed & assembly.is_point).astype(np.int32)


class _Bodies:
    """The measurements between bodies, linearized.

    A body's motion is a translation and, in radians, a rotation about its center, in the world's
    frame. The unknowns are scaled so that the diagonal is 1.
    """

    def __init__(self, assembly: Assembly, bodies: Indices, fixed: Flags) -> None:
        graph = assembly.graph
        assert graph.poses is not None
        self._d, self._dof = graph.dimension, graph.dof
        self._fixed = fixed
        self._poses = graph.poses
        self._bodies = bodies
        self._size = np.bincount(bodies)
        d = self._d
        self._center = np.stack(
            [np.bincount(bodies, graph.poses[:, k]) / self._size for k in range(d)], 1
        )
        ends = bodies[graph.edge_indices]
        between = ends[:, 0] != ends[:, 1]
        self._ends = np.ascontiguousarray(ends[between])
        # An edge that keeps the rotation of a landmark measures nothing.
        self._measured = np.flatnonzero(between) < assembly.measured
        start, end = _jacobians(assembly, self._center[bodies], between)
        self._blocks = _products(start, graph.information[between], end)

    def freedoms(self) -> list[Freedom]:
        """Return what bodies can do at no cost; of bodies that a measurement joins, one only.

        Where numbers overflow, nothing can be told.
        """
        first, joint, second = self._blocks
        if not all(np.isfinite(blocks).all() for blocks in self._blocks):
            return []
        i, j = self._ends.T
        count = len(self._fixed)
        diagonal = np.zeros((count, self._dof))
        np.add.at(diagonal, i, np.einsum("kii->ki", first))
        np.add.at(diagonal, j, np.einsum("kii->ki", second))
        # Zero to rounding is zero: else scaling would make it one.
        tiny = 1e-20 * diagonal.max(axis=1, keepdims=True)
        scale = np.sqrt(np.where(diagonal > tiny, diagonal, 1.0))
        topology = _core.Topology(count, np.ascontiguousarray(self._ends.astype(np.int32)))
        elimination = eliminate(topology, self._fixed, self._dof)
        matrix = _core.GraphMatrix(elimination, self._dof)
        matrix.assemble(
            topology,
            _scaled(first, scale[i], scale[i]),
            _scaled(joint, scale[i], scale[j]),
            _scaled(second, scale[j], scale[j]),
            np.zeros((count, self._dof, 1)),
        )
        free = elimination.free_nodes()
        damping = np.full(len(free) * self._dof, _DAMPING)
        while matrix.factorize(damping) >= 0:
            damping *= 10
        every = np.arange(len(free), dtype=np.int32)
        variance = matrix.inverse(every, every)
        large = np.flatnonzero(np.einsum("kii->k", variance) > _UNDETERMINED)
        ends = Groups(self._ends.ravel(), count)
        tied = np.bincount(self._ends[self._measured].ravel(), minlength=count)
        out, taken = [], np.zeros(count, np.bool_)
        for k in large[np.argsort(-self._size[free[large]], kind="stable")]:
            body = int(free[k])
            if taken[body]:
                continue
            values, vectors = np.linalg.eigh(variance[k])
            directions = vectors[:, values > _UNDETERMINED] / scale[body][:, None]
            if directions.shape[1] == 0:
                continue
            out.append(self._freedom(body, directions, int(tied[body]) <= 1))
            taken[self._ends[ends.of(body) // 2]] = True
        return out

    def keep(self, freedoms: list[Freedom]) -> None:
        """Add edges from a fixed body that keep what is undetermined."""
        d, dof, count = self._d, self._dof, len(freedoms)
        bodies = self._bodies[[freedom.node for freedom in freedoms]]
        first, _, own = self._blocks
        i, j = self._ends.T
        weights = np.bincount(i, np.einsum("kii->k", first), len(self._fixed))
        weights += np.bincount(j, np.einsum("kii->k", own), len(self._fixed))
        zero = np.zeros((count, dof, dof))
        second = zero.copy()
        for k, (freedom, body) in enumerate(zip(freedoms, bodies, strict=True)):
            lever = _rotating(self._poses[freedom.node, :d] - self._center[body])
            rows = np.zeros((len(freedom.translations) + len(freedom.rotations), dof))
            rows[: len(freedom.translations), :d] = freedom.translations
            rows[: len(freedom.translations), d:] = freedom.translations @ lever
            rows[len(freedom.translations) :, d:] = freedom.rotations
            second[k] = (weights[body] or 1.0) * rows.T @ rows
        fixed = np.full(count, np.flatnonzero(self._fixed)[0])
        self._ends = np.concatenate([self._ends, np.stack([fixed, bodies], 1)])
        self._measured = np.append(self._measured, np.zeros(count, np.bool_))
        added = (zero, zero, second)
        self._blocks = tuple(np.concatenate(pair) for pair in zip(self._blocks, added, strict=True))

    def _freedom(self, body: int, directions: Floats, exact: bool) -> Freedom:
        d, node = self._d, int(np.argmax(self._bodies == body))
        lever = _rotating(self._poses[node, :d] - self._center[body])
        motion = directions.copy()
        motion[:d] += lever @ directions[d:]
        motion /= np.sqrt(np.square(motion).sum(axis=0))
        axes, lengths, mixing = np.linalg.svd(motion[d:], full_matrices=True)
        turning = int(np.count_nonzero(lengths > _ZERO))
        pure = motion[:d] @ mixing[turning:].T
        across, sizes, _ = np.linalg.svd(pure, full_matrices=False)
        return Freedom(
            node,
            int(self._size[body]),
            across[:, sizes > _ZERO].T,
            axes[:, :turning].T,
            exact,
        )


def _jacobians(assembly: Assembly, center: Floats, rows: Flags) -> tuple[Floats, Floats]:
    """Return the derivatives of residuals by the motions of the bodies at their two ends."""
    graph = assembly.graph
    assert graph.poses is not None
    d, dof = graph.dimension, graph.dof
    i, j = graph.edge_indices[rows].T
    poses = graph.poses
    back = _core.rotation_matrices(np.ascontiguousarray(graph.measurements[rows]))
    turn = _core.rotation_matrices(poses)
    into = back.transpose(0, 2, 1) @ turn[i].transpose(0, 2, 1)
    reach = poses[j, :d].copy()
    if graph.sensor_offsets is not None:
        reach += np.einsum("kij,kj->ki", turn[j], graph.sensor_offsets[rows, :d])
    out = []
    for sign, node in ((-1.0, i), (1.0, j)):
        jacobian = np.zeros((len(i), dof, dof))
        jacobian[:, :d, :d] = sign * into
        jacobian[:, :d, d:] = sign * into @ _rotating(reach - center[node])
        if d == 2:
            jacobian[:, 2, 2] = sign
        else:
            e = residuals(graph)[rows, 3:]
            w = np.sqrt(np.maximum(1 - np.square(e).sum(axis=1), 0))
            mixed = w[:, None, None] * np.eye(3) - _rotating(e)
            own = turn[j].transpose(0, 2, 1)
            if graph.sensor_offsets is not None:
                at = _core.rotation_matrices(np.ascontiguousarray(graph.sensor_offsets[rows]))
                own = at.transpose(0, 2, 1) @ own
            jacobian[:, 3:, 3:] = sign / 2 * mixed @ own
        if graph.range_bearing_edges is not None:
            polar = graph.range_bearing_edges[rows]
            jacobian[polar, :d] = (
                range_bearing_by_position(graph, np.flatnonzero(rows)[polar]) @ jacobian[polar, :d]
            )
        out.append(jacobian)
    return out[0], out[1]


def _rotating(levers: Floats) -> Floats:
    """Return the matrices L with L w = w x lever, (..., d, 1) in 2D and (..., 3, 3) in 3D."""
    if levers.shape[-1] == 2:
        return np.stack([-levers[..., 1], levers[..., 0]], axis=-1)[..., None]
    out = np.zeros((*levers.shape, 3))
    x, y, z = np.moveaxis(levers, -1, 0)
    out[..., 0, 1], out[..., 0, 2] = z, -y
    out[..., 1, 0], out[..., 1, 2] = -z, x
    out[..., 2, 0], out[..., 2, 1] = y, -x
    return out


def _products(start: Floats, w: Floats, end: Floats) -> tuple[Floats, ...]:
    """Return start' W start, start' W end and end' W end."""
    with np.errstate(over="ignore", invalid="ignore"):
        back, ahead = start.transpose(0, 2, 1) @ w, end.transpose(0, 2, 1) @ w
        return back @ start, back @ end, ahead @ end


def _scaled(blocks: Floats, rows: Floats, columns: Floats) -> Floats:
    return np.ascontiguousarray(blocks / (rows[:, :, None] * columns[:, None, :]))
