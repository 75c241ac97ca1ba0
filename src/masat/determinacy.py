"""What the measurements of a graph leave undetermined, by node and direction.

Nodes that full measurements join move as one body. Between the bodies, and between them and what is
fixed, the other measurements are linearized at the poses. Directions in which a body can move at no
cost are undetermined: an edge from the world that measures just these, at the pose where the node
is, makes the system regular and changes neither the minimum nor chi2.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from masat import _core, lie
from masat.arrays import Flags, Floats, Indices
from masat.assembly import Assembly
from masat.errors import OptimizationError
from masat.graph import PoseGraph
from masat.residuals import residuals
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
    # Landmarks and the world are bodies of their own.
    bodies = np.arange(len(assembly.graph.ids), dtype=np.int32)
    at = assembly.poses_at
    _, first = np.unique(relative.structure.components, return_index=True)
    bodies[at] = at[first[relative.structure.components]]
    return np.unique(bodies, return_inverse=True)[1].astype(np.int32)


def with_undetermined_kept(assembly: Assembly) -> tuple[Assembly, list[str]]:
    """Return the assembly with what is undetermined kept at its poses, and a note of each."""
    found = undetermined(assembly)
    if not found:
        return assembly, []
    graph = assembly.graph
    assert graph.poses is not None
    d, dof = graph.dimension, graph.dof
    nodes = np.array([freedom.node for freedom in found])
    turn = _core.rotation_matrices(np.ascontiguousarray(graph.poses[nodes]))
    weight = np.median(np.einsum("kii->ki", graph.information), axis=0)
    weight = np.where(weight > 0, weight, 1.0)
    information = np.zeros((len(found), dof, dof))
    for k, freedom in enumerate(found):
        own = freedom.translations @ turn[k]
        information[k, :d, :d] = weight[:d].mean() * own.T @ own
        axes = freedom.rotations if d == 2 else freedom.rotations @ turn[k]
        information[k, d:, d:] = weight[d:].mean() * axes.T @ axes
    kept = assembly.with_edges_from_world(nodes, graph.poses[nodes], information)
    return kept, _notes(assembly, found)


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
        self._size = np.bincount(bodies)
        self._first = np.unique(bodies, return_index=True)[1]
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
        """Return what bodies can do at no cost; of bodies that a measurement joins, one only."""
        first, joint, second = self._blocks
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
        out, taken = [], np.zeros(count, np.bool_)
        for k in large[np.argsort(-self._size[free[large]], kind="stable")]:
            body = int(free[k])
            if taken[body]:
                continue
            values, vectors = np.linalg.eigh(variance[k])
            directions = vectors[:, values > _UNDETERMINED] / scale[body][:, None]
            if directions.shape[1] == 0:
                continue
            out.append(self._freedom(body, directions))
            touching = (self._ends == body).any(axis=1)
            taken[self._ends[touching]] = True
        return out

    def keep(self, freedoms: list[Freedom]) -> None:
        """Add edges from a fixed body that keep what is undetermined."""
        d, dof, count = self._d, self._dof, len(freedoms)
        bodies = np.array([self._body_of(freedom) for freedom in freedoms])
        zero = np.zeros((count, dof, dof))
        second = zero.copy()
        for k, (freedom, body) in enumerate(zip(freedoms, bodies, strict=True)):
            lever = _rotating(self._poses[freedom.node, :d] - self._center[body])
            rows = np.zeros((len(freedom.translations) + len(freedom.rotations), dof))
            rows[: len(freedom.translations), :d] = freedom.translations
            rows[: len(freedom.translations), d:] = freedom.translations @ lever
            rows[len(freedom.translations) :, d:] = freedom.rotations
            first, _, own = self._blocks
            near = np.einsum("kii->", own[self._ends[:, 1] == body])
            near += np.einsum("kii->", first[self._ends[:, 0] == body])
            second[k] = (near or 1.0) * rows.T @ rows
        fixed = np.full(count, np.flatnonzero(self._fixed)[0] if self._fixed.any() else -1)
        self._ends = np.concatenate([self._ends, np.stack([fixed, bodies], 1)])
        self._measured = np.append(self._measured, np.zeros(count, np.bool_))
        added = (zero, zero, second)
        self._blocks = tuple(np.concatenate(pair) for pair in zip(self._blocks, added, strict=True))

    def _body_of(self, freedom: Freedom) -> int:
        return int(np.flatnonzero(self._first == freedom.node)[0])

    def _freedom(self, body: int, directions: Floats) -> Freedom:
        d, node = self._d, int(self._first[body])
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
            bool(np.count_nonzero((self._ends == body).any(axis=1) & self._measured) <= 1),
        )


def refuse_undetermined(assembly: Assembly, what: str) -> None:
    """Raise an OptimizationError that names what is not determined, if anything is not."""
    found = undetermined(assembly)
    if found:
        said = _sentence(assembly, found[0]).replace("; kept at the initial guess", "")
        raise OptimizationError(f"{what}: {said}")


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
            jacobian[polar, :d] = _by_position(graph, rows, polar) @ jacobian[polar, :d]
        out.append(jacobian)
    return out[0], out[1]


def _by_position(graph: PoseGraph, rows: Flags, polar: Flags) -> Floats:
    """Return the derivatives of ranges and bearings by the position ahead of the measured pose."""
    assert graph.poses is not None
    d = graph.dimension
    i, j = graph.edge_indices[rows][polar].T
    z = graph.measurements[rows][polar]
    ranges = np.sqrt(np.square(z[:, :d]).sum(axis=1))
    z[:, :d] = 0
    ahead = lie.between(lie.compose(graph.poses[i], z), graph.poses[j])[:, :d]
    return _core.range_bearing_errors(np.ascontiguousarray(ahead), ranges)[1]


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
    back, ahead = start.transpose(0, 2, 1) @ w, end.transpose(0, 2, 1) @ w
    return back @ start, back @ end, ahead @ end


def _scaled(blocks: Floats, rows: Floats, columns: Floats) -> Floats:
    return np.ascontiguousarray(blocks / (rows[:, :, None] * columns[:, None, :]))


def _notes(assembly: Assembly, found: list[Freedom]) -> list[str]:
    """Return a sentence for each of the first bodies, and one for the rest."""
    notes = [_sentence(assembly, freedom) for freedom in found[:_MAX_NOTES]]
    if len(found) > _MAX_NOTES:
        rest = ", ".join(str(assembly.graph.ids[f.node]) for f in found[_MAX_NOTES:][:5])
        notes.append(
            f"{len(found) - _MAX_NOTES} more nodes are not determined in some direction, such as "
            f"{rest}: they stay there at the initial guess"
        )
    return notes


_MAX_NOTES = 5


def _sentence(assembly: Assembly, freedom: Freedom) -> str:
    graph = assembly.graph
    d, node = graph.dimension, int(graph.ids[freedom.node])
    is_point = bool(assembly.is_point[freedom.node])
    if freedom.size > 1:
        what = f"the {freedom.size} poses that are joined to node {node}"
    else:
        what = f"landmark {node}" if is_point else f"node {node}"
    free = []
    a, b = len(freedom.translations), len(freedom.rotations)
    if a == d:
        free.append("position")
    elif a:
        free.append("position along " + " and ".join(map(_axis, freedom.translations)))
    if b:
        if d == 2:
            free.append("heading")
        elif b == 3:
            free.append("rotation")
        else:
            free.append("rotation about " + " and ".join(map(_axis, freedom.rotations)))
    if is_point:
        cure = "an observation from another place"
    elif a and b:
        cure = "a prior on the full pose, or an edge of full information"
    elif a:
        cure = "a position fix, or an edge of full information"
    else:
        cure = ("a heading" if d == 2 else "a rotation prior") + ", or position fixes of other "
        cure += "nodes off that axis" if d == 3 else "nodes"
    return (
        f"{what}: {' and '.join(free)} not determined ({_seen(assembly, freedom)}); kept at the "
        f"initial guess. {cure[0].upper()}{cure[1:]} would determine it"
    )


def _axis(direction: Floats) -> str:
    for k, name in enumerate("xyz"[: len(direction)]):
        if abs(direction[k]) > 1 - 1e-6:
            return name
    shown = ", ".join(f"{value:.2g}" for value in direction)
    return f"({shown})"


def _seen(assembly: Assembly, freedom: Freedom) -> str:
    """Say what measures a body."""
    graph, source = assembly.graph, assembly.source
    own = np.flatnonzero(body_of_each_node(assembly) == _body(assembly, freedom))
    touching: Flags = np.asarray(np.isin(graph.edge_indices, own).any(axis=1))
    inside: Flags = np.asarray(np.isin(graph.edge_indices, own).all(axis=1))
    priors = int(np.count_nonzero(touching[assembly.prior_rows]))
    seen = int(np.count_nonzero(touching[assembly.observation_rows]))
    edges = touching[: len(source.edges)] & ~inside[: len(source.edges)]
    partly = int(np.count_nonzero(edges))
    parts = [
        f"{_NUMBERS.get(count, count)} {noun}{end if count > 1 else one}"
        for count, (noun, one, end) in (
            (priors, _kind_of_priors(assembly, touching)),
            (seen, ("observation", "", "s")),
            (partly, ("partial edge", "", "s")),
        )
        if count
    ]
    return "seen only by " + " and ".join(parts) if parts else "nothing measures it"


def _body(assembly: Assembly, freedom: Freedom) -> int:
    return int(body_of_each_node(assembly)[freedom.node])


_NUMBERS = {1: "one", 2: "two", 3: "three"}


def _kind_of_priors(assembly: Assembly, touching: Flags) -> tuple[str, str, str]:
    """Return what the priors of a body measure, and the endings of one and of several."""
    d, rows = assembly.graph.dimension, assembly.prior_rows
    information = assembly.graph.information[rows][touching[rows]]
    turned = information[:, d:, d:].any(axis=(1, 2))
    placed = information[:, :d, :d].any(axis=(1, 2))
    if not turned.any():
        return "position fix", "", "es"
    return (
        ("heading prior" if d == 2 else "rotation prior") if not placed.any() else "prior",
        "",
        "s",
    )
