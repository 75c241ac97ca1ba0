"""The pose graph: poses as nodes, relative measurements as edges, in flat arrays."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from masat import _checks as checks
from masat import _core, lie
from masat.arrays import Floats, Ids, Indices, locked
from masat.errors import GraphError
from masat.structure import Structure

# The fields that the structure depends on, and also holds.
_OF_STRUCTURE = ("ids", "edges", "fixed")
# Typed so that the field `structure` need not be optional: `__post_init__` fills it in.
_NOT_MADE: Any = None


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
            ids=nodes,
            poses=given,
            edges=pairs,
            measurements=z,
            information=matrices,
            fixed=held,
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
        return replace(
            self,
            poses=checks.rotations(given, "pose of node", self.ids, "node"),
            notes=tuple(dict.fromkeys([*self.notes, *notes])),
        )

    def with_root(self, root: ArrayLike) -> PoseGraph:
        """Return the graph with `root` as the gauge-fixed node of its component.

        Without this, the gauge-fixed node of a component without fixed nodes is its smallest id.

        Parameters
        ----------
        root : int or array_like of int
            The id of a node; or several, each in a component of its own. A fixed node is accepted
            and changes nothing.

        Raises
        ------
        GraphError
            If the graph has no such node, or if the node is not fixed but its component has fixed
            nodes.
        """
        return replace(self, structure=self.structure.with_roots(root))

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

    @property
    def components(self) -> Indices:
        """Connected component of each node, (n,), numbered in the order of their smallest ids."""
        return self.structure.components

    @property
    def gauge(self) -> Ids:
        """Ids of the nodes that are not optimized, ascending.

        They are the fixed nodes and, in each component without any, one gauge-fixed node: the
        root chosen by `with_root`, or else the smallest id.
        """
        return self.structure.gauge

    @property
    def elimination(self) -> _core.Elimination:
        """The order in which the optimized nodes are eliminated from the linear systems."""
        return self.structure.elimination

    def _check_fixed(self) -> None:
        if self.poses is not None or len(self.fixed) < 2:
            return
        _, count = np.unique(self.components[self.index(self.fixed)], return_counts=True)
        if count.max() > 1:
            raise GraphError(
                "several fixed nodes of one component need poses: give `poses`, or fix one node"
            )
