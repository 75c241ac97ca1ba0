"""The part of a graph that depends only on its ids, edges and fixed nodes."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from masat import _checks as checks
from masat import _core
from masat.arrays import Flags, Floats, Ids, Indices, locked
from masat.errors import GraphError

# Nested dissection takes about 4 us a node and saves up to half of each factorization. It pays off
# in the few factorizations of a solve above this many operations a node by minimum degree.
_MIN_DISSECTED_OPERATIONS = 3e5
# A session begins where ids jump by more than so many times the steps before and after.
NEW_SESSION = 10_000


class Structure:
    """The connectivity of a graph, and the order in which its linear systems are solved.

    It depends only on the ids, the edges and the fixed nodes. Graphs that differ in poses or
    measurements share one structure. Each property is computed on first use and then kept. A pickle
    holds only the arrays below, and the properties are computed again when they are needed.

    Parameters
    ----------
    ids : ndarray of int64, (n,)
        Node ids, ascending.
    edges : ndarray of int64, (m, 2)
        Node ids (from, to) of each edge.
    fixed : ndarray of int64
        Ids of the fixed nodes, ascending.
    dof : int
        Degrees of freedom of a pose: 3 or 6.
    roots : ndarray of int64, optional
        Ids that are chosen as gauge-fixed nodes of their components.
    ordered_like : Structure, optional
        Whose elimination order is taken over. Its nodes must be among these, and other edges must
        not join free nodes; the free nodes that it does not eliminate follow.
    """

    def __init__(
        self,
        ids: Ids,
        edges: Ids,
        fixed: Ids,
        dof: int,
        roots: Ids | None = None,
        ordered_like: Structure | None = None,
    ) -> None:
        self.ids = locked(ids)
        self.edges = locked(edges)
        self.fixed = locked(fixed)
        self.dof = dof
        self.roots = locked(np.empty(0, np.int64) if roots is None else roots)
        self.ordered_like = ordered_like

    def __reduce__(
        self,
    ) -> tuple[type[Structure], tuple[Ids, Ids, Ids, int, Ids, Structure | None]]:
        of_arrays = (self.ids, self.edges, self.fixed, self.dof, self.roots)
        return Structure, (*of_arrays, self.ordered_like)

    def index(self, ids: ArrayLike) -> Ids:
        """Return the indices of node ids, of any shape, in `ids`; unknown ones: GraphError."""
        wanted = checks.integers("ids", ids)
        indices = np.searchsorted(self.ids, wanted).clip(max=len(self.ids) - 1)
        unknown = wanted[self.ids[indices] != wanted]
        if unknown.size:
            raise GraphError(f"the graph has no node {unknown.flat[0]}")
        return indices.astype(np.int64)

    @cached_property
    def edge_indices(self) -> Indices:
        """Indices in `ids` of the nodes that each edge joins, (m, 2)."""
        if checks.without_gaps(self.ids):
            return locked((self.edges - self.ids[0]).astype(np.int32))
        return locked(np.searchsorted(self.ids, self.edges).astype(np.int32))

    @cached_property
    def topology(self) -> _core.Topology:
        """The adjacency, as flat arrays in the core."""
        return _core.Topology(len(self.ids), np.ascontiguousarray(self.edge_indices))

    @cached_property
    def components(self) -> Indices:
        """Connected component of each node, (n,), numbered in the order of their smallest ids."""
        return locked(self.topology.components())

    @cached_property
    def session_begins(self) -> Ids:
        """Indices of the nodes that begin another session, ascending: where the ids jump."""
        if len(self.ids) < 3 or checks.without_gaps(self.ids):
            return locked(np.empty(0, np.int64))
        # Differences of 64-bit integers fit only in unsigned ones.
        steps = np.diff(self.ids.view(np.uint64)).astype(np.float64)
        around = np.maximum(np.append(0.0, steps[:-1]), np.append(steps[1:], 0.0))
        return locked(1 + np.flatnonzero(steps > NEW_SESSION * around))

    @cached_property
    def gauge(self) -> Ids:
        """Ids of the nodes that are not optimized, ascending.

        They are the fixed nodes and, in each component without any, one gauge-fixed node: the
        chosen root, or else the smallest id.
        """
        labels = self.components
        if len(self.fixed) and not labels.any():
            return self.fixed
        # Components are numbered by their smallest ids: each begins where the label first grows.
        gauge_fixed = np.flatnonzero(np.diff(np.maximum.accumulate(labels), prepend=-1))
        # In descending order, so that of several roots of one component the smallest id remains.
        roots = np.sort(self.index(self.roots))[::-1]
        gauge_fixed[labels[roots]] = roots
        gauge_fixed = np.delete(gauge_fixed, labels[self.index(self.fixed)])
        return locked(np.sort(np.concatenate([self.fixed, self.ids[gauge_fixed]])))

    @cached_property
    def free(self) -> Indices:
        """Indices of the nodes that are optimized, ascending."""
        return locked(np.flatnonzero(~self._in_gauge()).astype(np.int32))

    @cached_property
    def elimination(self) -> _core.Elimination:
        """The order in which the free nodes are eliminated from the linear systems."""
        in_gauge = self._in_gauge()
        if self.ordered_like is None:
            return eliminate(self.topology, in_gauge, self.dof)
        known = self.ordered_like.elimination
        first = self.index(self.ordered_like.ids[known.free_nodes()[known.order()]])
        first = first[~in_gauge[first]]
        last = ~in_gauge
        last[first] = False
        place = np.cumsum(~in_gauge, dtype=np.int32) - 1
        order = place[np.concatenate([first, np.flatnonzero(last)])]
        return _core.Elimination(self.topology, in_gauge, order.astype(np.int32))

    def with_roots(self, roots: ArrayLike, components: Indices | None = None) -> Structure:
        """Return the structure with other gauge-fixed nodes, the connectivity shared.

        Parameters
        ----------
        roots : array_like of int
            Ids of the nodes, each in a component of its own.
        components : ndarray of int32, (n,), optional
            Component of each node where more than the edges connects nodes.

        Raises
        ------
        GraphError
            If a root is not in the graph, if two are in one component, or if a root is not fixed
            but its component has fixed nodes.
        """
        chosen = checks.distinct(checks.integers("roots", roots))
        labels = self.components if components is None else components
        component = labels[self.index(chosen)]
        with_fixed = np.isin(component, labels[self.index(self.fixed)])
        for root in chosen[with_fixed & ~np.isin(chosen, self.fixed)][:1]:
            raise GraphError(
                f"the root {root} is not fixed but its component holds fixed nodes, which "
                "keep their poses: leave the root out, or name one of them"
            )
        chosen, component = chosen[~with_fixed], component[~with_fixed]
        order = np.argsort(component, kind="stable")
        for k in np.flatnonzero(np.diff(component[order]) == 0)[:1]:
            a, b = chosen[order[k : k + 2]]
            raise GraphError(f"the roots {a} and {b} are in one component: choose one of them")
        others = ~np.isin(labels[self.index(self.roots)], component)
        out = Structure(
            self.ids,
            self.edges,
            self.fixed,
            self.dof,
            np.sort(np.concatenate([self.roots[others], chosen])),
        )
        out.share_connectivity(self)
        return out

    def share_connectivity(self, other: Structure) -> None:
        """Take over what follows from the edge indices of `other`, which must be the same."""
        for name in ("edge_indices", "topology", "components"):
            self.__dict__[name] = getattr(other, name)

    def check_fixed(self, poses: Floats | None) -> None:
        """Refuse several fixed nodes of one component if nothing tells their poses."""
        if poses is not None or len(self.fixed) < 2:
            return
        _, count = np.unique(self.components[self.index(self.fixed)], return_counts=True)
        if count.max() > 1:
            raise GraphError(
                "several fixed nodes of one component need poses: give `poses`, or fix one node"
            )

    def _in_gauge(self) -> Flags:
        out = np.zeros(len(self.ids), np.bool_)
        out[self.index(self.gauge)] = True
        return out


def joint_structure(poses: Structure, points: Ids, observations: Ids, priors: Ids) -> Structure:
    """Return the structure of poses, landmarks and the world, which is the last node.

    The world is fixed. A part without a prior or a fixed node has a pose as its gauge-fixed node.

    Parameters
    ----------
    poses : Structure
        That of the poses and their edges.
    points : ndarray of int64, (k,)
        Ids of the landmarks.
    observations : ndarray of int64, (l, 2)
        Ids (pose, landmark).
    priors : ndarray of int64, (p,)
        Ids of the nodes that priors tie to the world.
    """
    nodes = np.sort(np.concatenate([poses.ids, points]))
    if nodes[-1] == np.iinfo(np.int64).max:
        raise GraphError(f"the id {nodes[-1]} is the largest there is: give the nodes smaller ids")
    world = nodes[-1] + 1
    joint = Structure(
        np.append(nodes, world),
        np.concatenate([poses.edges, observations, np.stack([world + 0 * priors, priors], 1)]),
        np.append(poses.fixed, world),
        poses.dof,
        poses.roots,
    )
    if len(points) == 0:
        return joint
    labels = joint.components[joint.index(poses.ids)]
    own, first = np.unique(labels, return_index=True)
    chosen = joint.components[joint.index(np.concatenate([poses.roots, joint.fixed]))]
    roots = poses.ids[first[~np.isin(own, chosen)]]
    with_roots = Structure(
        joint.ids, joint.edges, joint.fixed, joint.dof, np.append(poses.roots, roots)
    )
    with_roots.share_connectivity(joint)
    return with_roots


def eliminate(topology: _core.Topology, in_gauge: Flags, block_size: int) -> _core.Elimination:
    """Return the elimination order with the fewest operations a factorization.

    The candidates are minimum degree (Amestoy, Davis, Duff, An approximate minimum degree ordering
    algorithm, 1996) and, where that leaves much work and the package pymetis is installed, nested
    dissection (Karypis and Kumar, A fast and high quality multilevel scheme for partitioning
    irregular graphs, 1998).

    Parameters
    ----------
    topology : Topology
        The adjacency of n nodes.
    in_gauge : ndarray of bool, (n,)
        Which nodes are not optimized.
    block_size : int
        Unknowns of each node.

    Returns
    -------
    Elimination
    """
    by_degree = _core.Elimination(topology, in_gauge, np.empty(0, np.int32))
    work = by_degree.operations(block_size)
    if work <= _MIN_DISSECTED_OPERATIONS * np.count_nonzero(~in_gauge):
        return by_degree
    order = nested_dissection(by_degree)
    if order is None:
        return by_degree
    dissected = _core.Elimination(topology, in_gauge, order)
    return dissected if dissected.operations(block_size) < work else by_degree


def nested_dissection(
    elimination: _core.Elimination, unevenness: float | None = None
) -> Indices | None:
    """Return the order of METIS, as indices into the free nodes; None without pymetis.

    Each half may be larger than the other one by the fraction `unevenness`. Default: that of METIS.
    """
    try:
        import pymetis
    except ImportError:
        return None
    start, neighbors = elimination.adjacency()
    if len(start) < 2:
        # METIS divides by the number of nodes.
        return np.empty(0, np.int32)
    options = pymetis.Options()
    if unevenness is not None:
        options.ufactor = round(1000 * unevenness)
    order, _ = pymetis.nested_dissection(pymetis.CSRAdjacency(start, neighbors), options=options)
    return np.array(order, np.int32)
