"""A graph with priors, landmarks or partial information as edges of one kind.

The solvers know one measurement: the relative pose of two nodes. A prior is an edge from the world,
a fixed node at the identity. A landmark is a node whose observations measure the translation alone;
an edge from the world, which it meets exactly, keeps its rotation at the identity. What nothing
determines is kept at the initial guess by further edges from the world (`determinacy.py`).
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from functools import cached_property

import numpy as np

from masat import lie
from masat.arrays import Flags, Floats, Ids
from masat.graph import PoseGraph
from masat.information import measured_directions, partial
from masat.residuals import as_poses, measured_poses
from masat.structure import Structure


@dataclass(frozen=True, eq=False, repr=False)
class AssembledGraph(PoseGraph):
    """A graph in which priors and landmarks are edges and nodes already.

    Attributes
    ----------
    offsets : ndarray, (m, 3) or (m, 7), or None
        Pose of the sensor that each edge measures, in the frame of the node that it leads to.
    range_bearing : ndarray of bool, (m,), or None
        Which edges measure range and bearing: in the place of the translation, their residual has
        that of the distance and the direction. The x axis of their measurement points at it.
    relative : PoseGraph or None
        The poses and those edges alone that determine a relative pose in full; None in a part of
        such a graph.
    values : int
        How many values its edges measure.
    """

    offsets: Floats | None = field(default=None)
    range_bearing: Flags | None = field(default=None)
    relative: PoseGraph | None = field(default=None)
    values: int = field(default=0)

    @property
    def sensor_offsets(self) -> Floats | None:
        """See `offsets`."""
        return self.offsets

    @property
    def range_bearing_edges(self) -> Flags | None:
        """See `range_bearing`."""
        return self.range_bearing


@dataclass(frozen=True, eq=False)
class Assembly:
    """A graph and the graph that is solved in its place.

    Attributes
    ----------
    source : PoseGraph
        The graph with priors and landmarks.
    graph : AssembledGraph
        Poses, landmarks and the world as nodes, in the order of their ids, the world last. Its
        edges are those of the source, its priors, its observations, one for the rotation of each
        landmark, and those that keep what is not determined.
    poses_at, points_at : ndarray of int64, (n,) and (k,)
        Indices of the source's poses and of its landmarks among the nodes.
    """

    source: PoseGraph
    graph: AssembledGraph
    poses_at: Ids
    points_at: Ids

    @property
    def world(self) -> int:
        """Index of the world among the nodes."""
        return len(self.graph.ids) - 1

    @cached_property
    def is_point(self) -> Flags:
        """Which nodes are landmarks, (n + k + 1,)."""
        out = np.zeros(len(self.graph.ids), np.bool_)
        out[self.points_at] = True
        return out

    @property
    def prior_rows(self) -> slice:
        """The edges that are priors."""
        first = len(self.source.edges)
        return slice(first, first + (0 if self.source.priors is None else len(self.source.priors)))

    @property
    def observation_rows(self) -> slice:
        """The edges that are observations of landmarks."""
        first, seen = self.prior_rows.stop, self.source.landmarks
        return slice(first, first + (0 if seen is None else len(seen.observations)))

    @property
    def measured(self) -> int:
        """How many edges stand for measurements; those after them have a chi2 of zero."""
        return int(self.observation_rows.stop)

    def placed(self, poses: Floats, points: Floats | None) -> Floats:
        """Return poses of all nodes, from those of the source and its landmarks."""
        out = np.tile(lie.identity(self.source.dimension), (len(self.graph.ids), 1))
        out[self.poses_at] = poses
        if points is not None:
            out[self.points_at] = as_poses(points)
        return out

    def disassembled(self, nodes: Floats) -> PoseGraph:
        """Return the source at the poses of all nodes."""
        moved = self.source.with_poses(nodes[self.poses_at])
        if self.source.landmarks is None:
            return moved
        return moved.with_points(nodes[self.points_at, : self.source.dimension])

    def at(self, nodes: Floats) -> Assembly:
        """Return the assembly with poses of all nodes."""
        return replace(self, graph=self.graph.with_poses(nodes))

    def with_notes(self, notes: list[str]) -> Assembly:
        """Return the assembly with more notes."""
        every = tuple(dict.fromkeys([*self.graph.notes, *notes]))
        return replace(self, graph=replace(self.graph, notes=every))

    def with_edges_from_world(
        self, nodes: Ids, measurements: Floats, information: Floats
    ) -> Assembly:
        """Return the assembly with more edges from the world, to nodes given by their indices."""
        if len(nodes) == 0:
            return self
        old = self.graph
        edges = np.stack([np.full(len(nodes), old.ids[-1]), old.ids[nodes]], 1)
        structure = Structure(
            old.ids,
            np.concatenate([old.edges, edges]),
            old.fixed,
            old.dof,
            ordered_like=old.structure.ordered_like,
        )
        return replace(self, graph=_extended(old, structure, measurements, information))


def with_edges(
    graph: PoseGraph, edges: Ids, measurements: Floats, information: Floats
) -> AssembledGraph:
    """Return a graph with more edges, of partial information, for the solvers.

    Parameters
    ----------
    graph : PoseGraph
        A graph of edges alone, assembled or not.
    edges : ndarray of int64, (k, 2)
        Ids (from, to).
    measurements, information : ndarray
        As of a graph.
    """
    if not isinstance(graph, AssembledGraph):
        known = {f.name: getattr(graph, f.name) for f in fields(PoseGraph)}
        known |= {"labels": None, "stamps": None}
        graph = AssembledGraph(**known, values=measured_directions(graph.information))
    every = np.concatenate([graph.edges, edges])
    structure = Structure(graph.ids, every, graph.gauge, graph.dof)
    return _extended(graph, structure, measurements, information)


def _extended(
    graph: AssembledGraph, structure: Structure, measurements: Floats, information: Floats
) -> AssembledGraph:
    """Return a graph with more edges, which the structure has already."""
    added, flags = len(measurements), graph.range_bearing
    return replace(
        graph,
        edges=structure.edges,
        structure=structure,
        ids=structure.ids,
        fixed=structure.fixed,
        measurements=np.concatenate([graph.measurements, measurements]),
        information=np.concatenate([graph.information, information]),
        offsets=_padded(graph.offsets, added),
        values=graph.values + measured_directions(information),
        range_bearing=None if flags is None else np.append(flags, np.zeros(added, np.bool_)),
    )


def needs_assembly(graph: PoseGraph) -> bool:
    """Whether a graph has more than edges that determine relative poses in full."""
    if isinstance(graph, AssembledGraph):
        return False
    return graph.priors is not None or graph.landmarks is not None or graph.has_partial_edges


def assemble(graph: PoseGraph) -> Assembly:
    """Return the graph that is solved in the place of one with priors, landmarks or partial edges.

    It has poses where the graph has, and positions of its landmarks if there are any.
    """
    d, priors, seen = graph.dimension, graph.priors, graph.landmarks
    joint = graph.joint_structure
    world = joint.ids[-1]
    edges, z, w = [graph.edges], [graph.measurements], [graph.information]
    offsets = None
    if priors is not None:
        edges.append(np.stack([np.full(len(priors), world), priors.ids], 1))
        z.append(priors.measurements)
        w.append(priors.information)
    if seen is not None:
        edges.append(seen.observations)
        z.append(measured_poses(seen))
        padded = np.zeros((len(seen.observations), graph.dof, graph.dof))
        padded[:, :d, :d] = seen.information
        w.append(padded)
        edges.append(np.stack([np.full(len(seen), world), seen.ids], 1))
        z.append(as_poses(np.zeros((len(seen), d))))
        upright = np.zeros((len(seen), graph.dof, graph.dof))
        upright[:, range(d, graph.dof), range(d, graph.dof)] = _typical_rotation(graph)
        w.append(upright)
    if priors is not None and priors.offsets is not None:
        offsets = np.tile(lie.identity(d), (sum(map(len, z)), 1))
        offsets[len(graph.edges) : len(graph.edges) + len(priors)] = priors.offsets
    flags = None
    if seen is not None and seen.range_bearing is not None:
        flags = np.zeros(sum(map(len, z)), np.bool_)
        first = len(flags) - len(seen) - len(seen.observations)
        flags[first : first + len(seen.observations)] = seen.range_bearing
    relative, information = relative_part(graph), np.concatenate(w)
    if seen is None and relative.structure is graph.structure:
        structure = Structure(
            joint.ids, joint.edges, joint.gauge, graph.dof, ordered_like=graph.structure
        )
        structure.share_connectivity(joint)
    else:
        structure = Structure(joint.ids, np.concatenate(edges), joint.gauge, graph.dof)
    # Most graphs have edges of full information alone, which need not be looked at again.
    in_full = len(relative.edges) if len(relative.edges) == len(graph.edges) else 0
    assembled = AssembledGraph(
        ids=structure.ids,
        poses=None,
        edges=structure.edges,
        measurements=np.concatenate(z),
        information=information,
        fixed=structure.fixed,
        notes=graph.notes,
        structure=structure,
        offsets=offsets,
        range_bearing=flags,
        relative=relative,
        values=graph.dof * in_full + measured_directions(information[in_full:]),
    )
    out = Assembly(
        graph,
        assembled,
        poses_at=np.searchsorted(structure.ids, graph.ids),
        points_at=np.searchsorted(structure.ids, graph.point_ids),
    )
    if graph.poses is None or (seen is not None and seen.positions is None):
        return out
    return out.at(out.placed(graph.poses, graph.points))


def translated(graph: PoseGraph, by: Floats) -> PoseGraph:
    """Return a graph with its poses, landmarks and priors moved by a translation, (d,)."""

    def moved(rows: Floats) -> Floats:
        out = rows.copy()
        out[:, : graph.dimension] += by
        return out

    out = graph if graph.poses is None else graph.with_poses(moved(graph.poses))
    if graph.points is not None:
        out = out.with_points(graph.points + by)
    if graph.priors is not None:
        priors = replace(graph.priors, measurements=moved(graph.priors.measurements))
        out = replace(out, priors=priors)
    return out


def relative_part(graph: PoseGraph) -> PoseGraph:
    """Return the graph of the poses and of those edges that determine a relative pose in full."""
    if not graph.has_partial_edges:
        return replace(graph, priors=None, landmarks=None, labels=None, stamps=None)
    keep = np.ones(len(graph.edges), np.bool_)
    keep[partial(graph.information)] = False
    old = graph.structure
    structure = Structure(old.ids, old.edges[keep], old.fixed, old.dof, old.roots)
    return PoseGraph(
        ids=structure.ids,
        poses=graph.poses,
        edges=structure.edges,
        measurements=np.ascontiguousarray(graph.measurements[keep]),
        information=np.ascontiguousarray(graph.information[keep]),
        fixed=structure.fixed,
        notes=graph.notes,
        structure=structure,
    )


def _typical_rotation(graph: PoseGraph) -> float:
    """Return the information of a typical edge about a rotation."""
    d = graph.dimension
    values = np.einsum("kii->k", graph.information[:, d:, d:]) / (graph.dof - d)
    values = values[values > 0]
    return float(np.median(values)) if len(values) else 1.0


def _padded(offsets: Floats | None, rows: int) -> Floats | None:
    if offsets is None:
        return None
    identity = lie.identity(2 if offsets.shape[1] == 3 else 3)
    return np.concatenate([offsets, np.tile(identity, (rows, 1))])
