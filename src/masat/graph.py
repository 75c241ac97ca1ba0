"""The pose graph: poses as nodes, relative measurements as edges, in flat arrays."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from masat import _checks as checks
from masat import _core, lie
from masat.arrays import Floats, Ids, Indices
from masat.errors import GraphError
from masat.structure import eliminate


@dataclass(frozen=True, eq=False, repr=False)
class PoseGraph:
    """An immutable pose graph in SE(2) or SE(3), checked when it is made.

    Make one with `PoseGraph.from_arrays` or `masat.read`. Node arrays follow `ids`, edge arrays
    the order of the input. All arrays are read-only; `with_poses` makes a changed copy.

    Attributes
    ----------
    ids : ndarray of int64, (n,)
        Node ids, ascending; any integers, gaps allowed.
    poses : ndarray, (n, 3) or (n, 7), or None
        x, y, theta or x, y, z, qx, qy, qz, qw: meters, radians, unit quaternions; None as long as
        nobody has given or guessed them.
    edges : ndarray of int64, (m, 2)
        Ids of the nodes (from, to) that each edge joins.
    measurements : ndarray, (m, 3) or (m, 7)
        Pose of `to` in the frame of `from`, as measured.
    information : ndarray, (m, 3, 3) or (m, 6, 6)
        Inverse covariance of each measurement, in the order of g2o: x, y, theta, or translation
        and vector part of the quaternion.
    fixed : ndarray of int64
        Ids of the nodes that keep their poses, ascending.
    notes : tuple of str
        What the reader or the initial guess passed over, assumed or bridged.
    """

    ids: Ids
    poses: Floats | None
    edges: Ids
    measurements: Floats
    information: Floats
    fixed: Ids
    notes: tuple[str, ...] = field(default=())

    @classmethod
    def from_arrays(
        cls,
        edges: ArrayLike,
        measurements: ArrayLike,
        information: ArrayLike | None = None,
        *,
        ids: ArrayLike | None = None,
        poses: ArrayLike | None = None,
        fixed: Iterable[int] = (),
        notes: Iterable[str] = (),
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
            One symmetric positive-definite matrix an edge, or one for all; d is 3 or 6. Default:
            the identity.
        ids : array_like of int, (n,), optional
            Node ids in any order, that of `poses`. Default: those that the edges name, ascending.
        poses : array_like, (n, 3) or (n, 7), optional
            Poses of the nodes.
        fixed : iterable of int, optional
            Ids of the nodes that keep their poses. Several in one component need `poses`.
        notes : iterable of str, optional
            Remarks to carry along.

        Returns
        -------
        PoseGraph

        Raises
        ------
        GraphError
            Naming the node or edge at fault: no nodes, numbers that are not finite, ids that are
            not known, not integers or not unique, an edge from a node to itself, quaternions that
            are no rotations, shapes that do not fit.
        InformationError
            Counting the matrices that are not symmetric positive definite.
        """
        z = checks.matrix("measurements", measurements)
        pairs = checks.integers("edges", edges)
        if pairs.size == 0:
            pairs = pairs.reshape(0, 2)
        if pairs.ndim != 2 or pairs.shape[1] != 2:
            raise GraphError(f"edges must have shape (m, 2), got {pairs.shape}")
        given = None if poses is None else checks.matrix("poses", poses)
        if len(z) == 0:
            z = z.reshape(0, 3 if given is None else given.shape[1])
        if z.shape[1] not in (3, 7):
            raise GraphError(f"measurements must have shape (m, 3) or (m, 7), got {z.shape}")
        if len(pairs) != len(z):
            raise GraphError(f"{len(pairs)} edges but {len(z)} measurements")
        dimension = 2 if z.shape[1] == 3 else 3

        nodes = checks.distinct(pairs) if ids is None else checks.integers("ids", ids)
        if nodes.ndim != 1:
            raise GraphError(f"ids must have shape (n,), got {nodes.shape}")
        if len(nodes) == 0:
            raise GraphError("the graph is empty: it has no node")
        if given is not None and given.shape != (len(nodes), z.shape[1]):
            raise GraphError(
                f"poses must have shape ({len(nodes)}, {z.shape[1]}) to go with the ids and the "
                f"measurements, got {given.shape}"
            )
        z = checks.rotations(z, "measurement of edge", pairs, "edge")
        if given is not None:
            given = checks.rotations(given, "pose of node", nodes, "node")
        nodes, given = checks.ascending(nodes, given)
        checks.known_edges(nodes, pairs)
        held = checks.integers("fixed", sorted(set(fixed)))
        for node in held[~np.isin(held, nodes)][:1] if len(held) else ():
            raise GraphError(f"the fixed node {node} is not in the graph")
        matrices = checks.information_matrices(information, pairs, lie.DOF[dimension])
        graph = cls(
            ids=checks.frozen(nodes),
            poses=None if given is None else checks.frozen(given),
            edges=checks.frozen(pairs),
            measurements=checks.frozen(z),
            information=checks.frozen(matrices),
            fixed=checks.frozen(held),
            notes=tuple(notes),
        )
        graph._check_fixed()
        return graph

    @property
    def dimension(self) -> int:
        """2 or 3."""
        return 2 if self.measurements.shape[1] == 3 else 3

    @property
    def dof(self) -> int:
        """Degrees of freedom of a pose: 3 or 6."""
        return lie.DOF[self.dimension]

    def __repr__(self) -> str:
        placed = "with" if self.poses is not None else "without"
        return (
            f"PoseGraph({self.dimension}D, {len(self.ids)} nodes, {len(self.edges)} edges, "
            f"{placed} poses)"
        )

    def with_poses(self, poses: ArrayLike, *, notes: Iterable[str] = ()) -> PoseGraph:
        """Return the graph with other poses, (n, 3) or (n, 7) in the order of `ids`.

        `notes` are added to those of the graph.
        """
        given = checks.matrix("poses", poses)
        if given.shape != (len(self.ids), lie.POSE_SIZE[self.dimension]):
            raise GraphError(f"poses of shape {given.shape} do not fit {self!r}")
        graph = replace(
            self,
            poses=checks.frozen(checks.rotations(given, "pose of node", self.ids, "node")),
            notes=tuple(dict.fromkeys([*self.notes, *notes])),
        )
        # What depends on the edges alone stays valid.
        for name in ("edge_indices", "topology", "components", "gauge", "elimination"):
            if name in self.__dict__:
                graph.__dict__[name] = self.__dict__[name]
        return graph

    def index(self, ids: ArrayLike) -> Ids:
        """Return the places of node ids, of any shape, in `ids`; unknown ones are a GraphError."""
        wanted = checks.integers("ids", ids)
        places = np.searchsorted(self.ids, wanted).clip(max=len(self.ids) - 1)
        unknown = wanted[self.ids[places] != wanted]
        if unknown.size:
            raise GraphError(f"the graph has no node {unknown.flat[0]}")
        return places.astype(np.int64)

    @cached_property
    def edge_indices(self) -> Indices:
        """Places in `ids` of the nodes that each edge joins, (m, 2)."""
        if checks.without_gaps(self.ids):
            return checks.frozen((self.edges - self.ids[0]).astype(np.int32))
        return checks.frozen(np.searchsorted(self.ids, self.edges).astype(np.int32))

    @cached_property
    def topology(self) -> _core.Topology:
        """The adjacency, as flat arrays in the core; built on first use."""
        return _core.Topology(len(self.ids), np.ascontiguousarray(self.edge_indices))

    @cached_property
    def components(self) -> Indices:
        """Connected component of each node, (n,), numbered by their smallest ids."""
        return checks.frozen(self.topology.components())

    @cached_property
    def gauge(self) -> Ids:
        """The ids that hold the gauge: `fixed`, and the smallest of each free component."""
        labels = self.components
        # Components are numbered by their smallest ids: each begins where the label first grows.
        first = np.flatnonzero(np.diff(np.maximum.accumulate(labels), prepend=-1))
        held = labels[self.index(self.fixed)]
        free = self.ids[np.delete(first, held)]
        return checks.frozen(np.sort(np.concatenate([self.fixed, free])))

    @cached_property
    def elimination(self) -> _core.Elimination:
        """In what order the systems of the graph are solved, the anchors held; found once."""
        held = np.zeros(len(self.ids), np.bool_)
        held[self.index(self.gauge)] = True
        return eliminate(self.topology, held, self.dof)

    def _check_fixed(self) -> None:
        if self.poses is not None or len(self.fixed) < 2:
            return
        _, count = np.unique(self.components[self.index(self.fixed)], return_counts=True)
        if count.max() > 1:
            raise GraphError(
                "several fixed nodes of one component need poses: give `poses`, or fix one node"
            )
