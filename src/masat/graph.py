"""The pose graph: poses as nodes, relative measurements as edges, in flat arrays."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from masat import _checks as checks
from masat import _core, construction, editing, lie, renaming, residuals
from masat import stamps as times
from masat.arrays import Flags, Floats, Ids, Indices, Labels, Stamps, locked
from masat.errors import GraphError
from masat.information import partial
from masat.measurements import (
    Landmarks,
    Priors,
    check_landmarks,
    check_priors,
    joined,
    joined_landmarks,
)
from masat.structure import Structure, joint_structure

# The fields that the structure depends on, and also holds.
_OF_STRUCTURE = ("ids", "edges", "fixed")
# Typed so that the field `structure` need not be optional: `__post_init__` fills it in.
_NOT_MADE: Any = None


@dataclass(frozen=True, eq=False, repr=False)
class PoseGraph:
    """An immutable pose graph in SE(2) or SE(3), checked when it is made.

    Make one with `PoseGraph.from_arrays` or `masat.read`. Arrays over nodes are in the order of
    `ids`, arrays over edges in the order of the input. All arrays are read-only. The methods
    `with_...`, `without_...` and `relabel` return changed copies, and check only what is new.
    `len(graph)` is the number of nodes.

    Attributes
    ----------
    ids : ndarray of int64, (n,)
        Node ids, ascending; any integers, gaps allowed.
    poses : ndarray, (n, 3) or (n, 7), or None
        x, y, theta or x, y, z, qx, qy, qz, qw: meters, radians, unit quaternions. None until they
        are given or an initial guess is made.
    edges : ndarray of int64, (m, 2)
        Ids of the nodes (from, to) that each edge joins.
    measurements : ndarray, (m, 3) or (m, 7)
        Pose of `to` in the frame of `from`, as measured.
    information : ndarray, (m, 3, 3) or (m, 6, 6)
        Inverse covariance of each measurement, in the order of g2o: x, y, theta, or translation
        and vector part of the quaternion. It may be semidefinite: what was not measured has none.
    fixed : ndarray of int64
        Ids of the nodes that keep their poses, ascending.
    notes : tuple of str
        Everything that the reader or the initial guess skipped, assumed or filled in.
    labels : ndarray of int64 or str, (m,), or None
        A label for each edge.
    stamps : ndarray of float64 or int64, (n,), or None
        Time of each node: seconds if float64, nanoseconds if int64.
    priors : Priors or None
        Measurements of nodes in the world's frame, such as satellite fixes.
    landmarks : Landmarks or None
        Points, and what poses saw of them; `points` and `point_ids` are short for its arrays.
    structure : Structure
        The connectivity, the gauge and the elimination order, which depend only on ids, edges and
        fixed nodes. Graphs that differ in nothing else share one structure.
    """

    ids: Ids
    poses: Floats | None
    edges: Ids
    measurements: Floats
    information: Floats
    fixed: Ids
    notes: tuple[str, ...] = field(default=())
    labels: Labels | None = field(default=None)
    stamps: Stamps | None = field(default=None)
    priors: Priors | None = field(default=None)
    landmarks: Landmarks | None = field(default=None)
    structure: Structure = field(default=_NOT_MADE, repr=False, compare=False)

    def __post_init__(self) -> None:
        structure = self.structure
        # A copy by `dataclasses.replace` shares the structure unless what it depends on changed.
        if structure is None or any(
            getattr(structure, name) is not getattr(self, name) for name in _OF_STRUCTURE
        ):
            structure = Structure(self.ids, self.edges, self.fixed, self.dof)
        self.__dict__.update(
            {name: getattr(structure, name) for name in _OF_STRUCTURE},
            structure=structure,
            poses=None if self.poses is None else locked(self.poses),
            measurements=locked(self.measurements),
            information=locked(self.information),
            labels=None if self.labels is None else locked(self.labels),
            stamps=None if self.stamps is None else locked(self.stamps),
        )

    def __getstate__(self) -> dict[str, Any]:
        return {f.name: getattr(self, f.name) for f in fields(self) if f.name not in _OF_STRUCTURE}

    def __setstate__(self, state: dict[str, Any]) -> None:
        structure = state["structure"]
        self.__dict__.update(state, **{name: getattr(structure, name) for name in _OF_STRUCTURE})
        self.__post_init__()

    @classmethod
    def from_arrays(
        cls,
        edges: ArrayLike,
        measurements: ArrayLike,
        information: ArrayLike | None = None,
        *,
        ids: ArrayLike | None = None,
        poses: ArrayLike | None = None,
        fixed: int | Iterable[int] = (),
        notes: Iterable[str] = (),
        labels: ArrayLike | None = None,
        stamps: ArrayLike | None = None,
        priors: Priors | Iterable[Priors] | None = None,
        landmarks: Landmarks | Iterable[Landmarks | None] | None = None,
    ) -> PoseGraph:
        """Check the arrays and make a graph of copies of them.

        Parameters
        ----------
        edges : array_like of int, (m, 2)
            Ids (from, to). A pair may occur more than once: each is a measurement of its own.
        measurements : array_like, (m, 3) or (m, 7)
            Pose of `to` in the frame of `from`. Quaternions off unit length by rounding are
            normalized.
        information : array_like, (m, d, d) or (d, d), optional
            One symmetric positive-semidefinite matrix an edge, or one for all; d is 3 or 6. A
            direction that was not measured has none. Default: the identity.
        ids : array_like of int, (n,), optional
            Node ids in any order, that of `poses`. Default: those that the edges name, ascending.
        poses : array_like, (n, 3) or (n, 7), optional
            Poses of the nodes.
        fixed : int or iterable of int, optional
            Ids of the nodes that keep their poses. Several in one component need `poses`.
        notes : iterable of str, optional
            Remarks to keep with the graph.
        labels : array_like, (m,), optional
            One integer or short string an edge, such as the sensor or the session it comes from;
            or one for all edges. Strings have at most 64 characters and no control characters.
        stamps : array_like, (n,), optional
            Times of the nodes in the order of `ids`: floating-point numbers are seconds, integers
            are nanoseconds.
        priors : Priors or iterable of Priors, optional
            Measurements in the world's frame: `masat.gps`, `masat.headings`, `masat.altitudes`,
            `masat.pose_priors`. A node that only priors name is added to the graph.
        landmarks : Landmarks or iterable of Landmarks, optional
            Points and their observations: `masat.landmarks`, `masat.range_bearing`.

        Returns
        -------
        PoseGraph

        Raises
        ------
        GraphError
            If there is no node, if numbers are not finite, not real or masked, if ids are unknown,
            not integers or not unique, if an edge joins a node to itself, if a quaternion is far
            from unit length, or if shapes do not fit. It names the first node or edge at fault.
        InformationError
            If information matrices are zero or not symmetric positive semidefinite. It counts them.
        """
        return construction.from_arrays(
            cls,
            edges,
            measurements,
            information,
            ids=ids,
            poses=poses,
            fixed=fixed,
            notes=notes,
            labels=labels,
            stamps=stamps,
            priors=priors,
            landmarks=landmarks,
        )

    @property
    def dimension(self) -> int:
        """2 or 3."""
        return 2 if self.measurements.shape[1] == 3 else 3

    @property
    def dof(self) -> int:
        """Degrees of freedom of a pose: 3 or 6."""
        return lie.DOF[self.dimension]

    @cached_property
    def chi2_per_edge(self) -> Floats:
        """The cost e' W e of each edge at the graph's poses, (m,): residual e, information W."""
        return locked(residuals.chi2_per_edge(self))

    @cached_property
    def chi2_per_prior(self) -> Floats:
        """The cost e' W e of each prior at the graph's poses and points, (p,)."""
        return locked(residuals.chi2_per_prior(self))

    @cached_property
    def chi2_per_observation(self) -> Floats:
        """The cost e' W e of each observation of a landmark, (l,)."""
        return locked(residuals.chi2_per_observation(self))

    @property
    def chi2(self) -> float:
        """The cost that `masat.optimize` minimizes: that of all edges, priors and observations."""
        total = float(self.chi2_per_edge.sum())
        if self.priors is not None:
            total += float(self.chi2_per_prior.sum())
        if self.landmarks is not None:
            total += float(self.chi2_per_observation.sum())
        return total

    @property
    def points(self) -> Floats | None:
        """Positions of the landmarks, (k, 2) or (k, 3); None without any, or before a solve."""
        return None if self.landmarks is None else self.landmarks.positions

    @property
    def point_ids(self) -> Ids:
        """Ids of the landmarks, (k,), ascending."""
        return np.empty(0, np.int64) if self.landmarks is None else self.landmarks.ids

    @property
    def sensor_offsets(self) -> Floats | None:
        """Where edges measure something else than the pose of the node that they lead to."""
        return None

    @property
    def range_bearing_edges(self) -> Flags | None:
        """Which edges measure the range and bearing of a landmark, if any can."""
        return None

    @cached_property
    def has_partial_edges(self) -> bool:
        """Whether the information of an edge leaves a direction undetermined."""
        return len(partial(self.information)) > 0

    def __len__(self) -> int:
        return len(self.ids)

    def _repr_html_(self) -> str:
        from masat.display import graph_html

        return graph_html(self)

    def __repr__(self) -> str:
        more = "" if self.priors is None else f"{len(self.priors)} priors, "
        more += "" if self.landmarks is None else f"{len(self.landmarks)} landmarks, "
        return (
            f"PoseGraph({self.dimension}D, {len(self.ids)} nodes, {len(self.edges)} edges, {more}"
            f"{'without' if self.poses is None else 'with'} poses)"
        )

    def with_poses(self, poses: ArrayLike, *, notes: Iterable[str] = ()) -> Self:
        """Return the graph with other poses, (n, 3) or (n, 7) in the order of `ids`.

        `notes` are added to those of the graph.
        """
        given = checks.table("poses", poses)
        if given.shape != (len(self.ids), lie.POSE_SIZE[self.dimension]):
            raise GraphError(f"poses of shape {given.shape} do not fit {self!r}")
        return replace(
            self,
            poses=checks.rotations(given, "pose", self.ids, "node"),
            notes=tuple(dict.fromkeys([*self.notes, *notes])),
        )

    def with_stamps(self, stamps: ArrayLike | None) -> PoseGraph:
        """Return the graph with other stamps, (n,) in the order of `ids`, or with None."""
        return replace(self, stamps=times.node_stamps(stamps, self.ids))

    def pose_at(
        self,
        t: ArrayLike,
        *,
        nodes: ArrayLike | None = None,
        max_gap: float | None = None,
    ) -> Floats:
        """Return the pose at a time between those of the nodes.

        Between two nodes the body moves with constant velocity and constant angular velocity in
        its own frame (`masat.lie.interpolate`). At the stamp of a node its pose is returned.

        Parameters
        ----------
        t : float, int or array_like
            Times in the unit of `stamps`: seconds, or integers of nanoseconds.
        nodes : array_like of int, optional
            Ids of the nodes to interpolate between, such as those of one robot. Default: all.
        max_gap : float, optional
            Largest time between two nodes that is interpolated, in the unit of `stamps`. Default:
            no limit.

        Returns
        -------
        ndarray, (..., 3) or (..., 7)
            One pose for each time, in the shape of `t`.

        Raises
        ------
        GraphError
            If the graph has no poses or no stamps, if a time is before the first stamp or after the
            last one, if two nodes have the same stamp, if the nodes before and after a time are
            further apart than `max_gap`, or if they are in components with frames of their own.
        """
        return times.pose_at(self, t, nodes, max_gap)

    def with_priors(self, priors: Priors | Iterable[Priors] | None) -> PoseGraph:
        """Return the graph with these priors in place of those it has; None removes them.

        To add some: ``graph.with_priors([graph.priors, more])``.

        Raises
        ------
        GraphError
            If a prior names an unknown node, or is in 2D where the graph is in 3D or conversely; or
            if one on a landmark measures more than its position.
        """
        new = joined(priors)
        if new is not None:
            check_priors(new, self.dimension, self.ids, self.point_ids)
        return replace(self, priors=new)

    def with_landmarks(self, landmarks: Landmarks | Iterable[Landmarks | None] | None) -> PoseGraph:
        """Return the graph with these landmarks in place of those it has; None removes them.

        To add some: ``graph.with_landmarks([graph.landmarks, more])``.

        Raises
        ------
        GraphError
            If an observation names an unknown pose, if a landmark has the id of a pose, if the
            landmarks are in 2D where the graph is in 3D or conversely, or if a prior of the graph
            names a landmark that would be gone: replace the priors first, with `with_priors`.
        """
        landmarks = joined_landmarks(landmarks)
        if landmarks is not None:
            check_landmarks(landmarks, self.dimension, self.ids)
        out = replace(self, landmarks=landmarks)
        if self.priors is not None:
            check_priors(self.priors, self.dimension, self.ids, out.point_ids)
        return out

    def with_points(self, positions: ArrayLike) -> PoseGraph:
        """Return the graph with its landmarks at other positions, in the order of `point_ids`."""
        if self.landmarks is None:
            raise GraphError("the graph has no landmarks")
        return replace(self, landmarks=self.landmarks.with_positions(positions))

    def with_root(self, root: ArrayLike) -> PoseGraph:
        """Return the graph with `root` as the gauge-fixed node of its component.

        Without this, the gauge-fixed node of a component without fixed nodes is its smallest id. A
        component with priors has none: the priors place it in the world's frame.

        Parameters
        ----------
        root : int or array_like of int
            The id of a node; or several, each in a component of its own. A fixed node is accepted
            and changes nothing.

        Raises
        ------
        GraphError
            If the graph has no such node, or if the node is not fixed but its component has fixed
            nodes or priors.
        """
        roots = checks.distinct(checks.integers("roots", root))
        if self.priors is not None:
            placed = self._placed_by_priors[self.index(roots)]
            for node in roots[placed & ~np.isin(roots, self.fixed)][:1]:
                raise GraphError(
                    f"the root {node} cannot be chosen: priors place its component in the world's "
                    "frame, so all of its nodes are optimized; leave the root out"
                )
        return replace(self, structure=self.structure.with_roots(roots, self.components))

    def with_fixed(self, ids: int | Iterable[int]) -> PoseGraph:
        """Return the graph with these fixed nodes in place of those it has.

        Parameters
        ----------
        ids : int or iterable of int
            Node ids; an empty list fixes none. Several in one component need poses.
        """
        return editing.with_fixed(self, ids)

    def with_edges(
        self,
        edges: ArrayLike,
        measurements: ArrayLike,
        information: ArrayLike | None = None,
        *,
        labels: ArrayLike | None = None,
        ids: ArrayLike | None = None,
        poses: ArrayLike | None = None,
        stamps: ArrayLike | None = None,
    ) -> PoseGraph:
        """Return the graph with more edges and, if they name any, new nodes.

        The new edges come after those of the graph.

        Parameters
        ----------
        edges, measurements, information, labels : array_like
            The new edges, as in `from_arrays`. If only some edges of the graph have labels, the
            others get -1 among integers and the empty string among strings.
        ids : array_like of int, (k,), optional
            Ids of the new nodes, in the order of `poses`. Default: those that `edges` name and the
            graph does not have, ascending. If given, an edge to any other unknown node is refused.
        poses : array_like, (k, 3) or (k, 7), optional
            Poses of the new nodes. Default, if the graph has poses: a new node is placed by the
            measurements along the fewest edges from the nodes that the graph had. All others keep
            their poses.
        stamps : array_like, (k,), optional
            Times of the new nodes, in the order of `ids`. They are needed if the graph has stamps.

        Raises
        ------
        GraphError
            As in `from_arrays`, for the new edges and nodes; also if a new node has to be placed
            but no edges lead to it. Edges are counted from 0 in `edges`.
        """
        return editing.with_edges(
            self,
            edges,
            measurements,
            information,
            labels=labels,
            ids=ids,
            poses=poses,
            stamps=stamps,
        )

    def without_edges(self, which: ArrayLike) -> PoseGraph:
        """Return the graph without some edges; nodes that lose all their edges remain.

        Parameters
        ----------
        which : array_like of int, or of bool, (m,)
            Indices of the edges to remove, or a mask that is true for them.
        """
        return editing.without_edges(self, which)

    def without_nodes(self, ids: int | Iterable[int]) -> PoseGraph:
        """Return the graph without some nodes and without the edges that join them to others.

        Parameters
        ----------
        ids : int or iterable of int
            Ids of the nodes to remove.
        """
        return editing.without_nodes(self, ids)

    def relabel(self, to: int | Mapping[int, int] | Callable[[int], int]) -> PoseGraph:
        """Return the graph with other ids of nodes and landmarks; all that names them follows.

        Parameters
        ----------
        to : int, mapping or callable
            An offset to add to all ids, a mapping from old to new ids (those that are not in it
            remain), or a function from the old to the new id.

        Raises
        ------
        GraphError
            If two nodes or landmarks would get the same id, if a mapping names an unknown id, or
            if a new id is no integer of 64 bits.
        """
        return renaming.relabel(self, to)

    def index(self, ids: ArrayLike) -> Ids:
        """Return the indices in `ids` of node ids of any shape; an unknown id is a GraphError."""
        return self.structure.index(ids)

    @property
    def edge_indices(self) -> Indices:
        """Indices in `ids` of the nodes that each edge joins, (m, 2)."""
        return self.structure.edge_indices

    @property
    def topology(self) -> _core.Topology:
        """The adjacency, as flat arrays in the core."""
        return self.structure.topology

    @cached_property
    def joint_structure(self) -> Structure:
        """The structure of poses, landmarks and the world, which is the last node."""
        none = np.empty(0, np.int64)
        return joint_structure(
            self.structure,
            self.point_ids,
            none.reshape(0, 2) if self.landmarks is None else self.landmarks.observations,
            none if self.priors is None else self.priors.ids,
        )

    @cached_property
    def components(self) -> Indices:
        """Connected component of each node, (n,), numbered in the order of their smallest ids.

        Observations of one landmark connect poses, and so do priors: all parts with priors lie in
        the frame of the world.
        """
        if self.priors is None and self.landmarks is None:
            return self.structure.components
        joint = self.joint_structure
        labels = joint.components[joint.index(self.ids)]
        if not labels.any():
            return locked(labels)
        # A landmark may have a smaller id than the poses that saw it.
        _, first, own = np.unique(labels, return_index=True, return_inverse=True)
        return locked(np.argsort(np.argsort(first))[own].astype(np.int32))

    @property
    def _placed_by_priors(self) -> Flags:
        """Which nodes are in a component with priors, (n,): that of the world."""
        joint = self.joint_structure
        return np.asarray(joint.components[joint.index(self.ids)] == joint.components[-1])

    @cached_property
    def gauge(self) -> Ids:
        """Ids of the nodes that are not optimized, ascending.

        They are the fixed nodes and, in each component without any and without priors, one
        gauge-fixed node: the root chosen by `with_root`, or else the smallest id.
        """
        if self.priors is None and self.landmarks is None:
            return self.structure.gauge
        gauge = self.joint_structure.gauge
        return locked(gauge[np.isin(gauge, self.ids)])

    @property
    def elimination(self) -> _core.Elimination:
        """The order in which the optimized nodes are eliminated from the linear systems."""
        return self.structure.elimination
