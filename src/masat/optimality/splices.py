"""Parts in which two minima differ, so that the better part of each can be taken."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from masat import _core, lie
from masat.arrays import Flags, Floats
from masat.graph import PoseGraph
from masat.optimality.subgraphs import Subgraph, connected_parts, neighborhood

# Radians by which the rotation residual of an edge differs between minima that have decided
# differently there. The lower, the larger are the parts: the first leave most neighbors apart, the
# last take together what belongs together.
_DIFFERENT = (0.6, 0.3, 0.15)
# Edges from such an edge within which nodes are free while the other minimum's part is tried.
_REACH = 2


# Radians and meters: poses that changed by less are the same as before.
_SAME_POSE = 0.01
# Radians: where no node has rotated by more, an optimizer is back at a minimum in 2D.
_SAME_ROTATION = 0.1


class OtherMinimum:
    """Another minimum, and which parts of it are known not to lower chi2.

    Parameters
    ----------
    poses : ndarray, (n, 3) or (n, 7)
        The poses there.
    """

    def __init__(self, poses: Floats) -> None:
        self.poses = poses
        self._refused: dict[bytes, Floats] = {}

    def parts(self, graph: PoseGraph, poses: Floats) -> Iterator[Flags]:
        """Yield sets of nodes, (n,) each, in which two minima differ, the large ones last.

        A set is left out if it was refused and its nodes and their neighbors are where they were
        then.

        Parameters
        ----------
        graph : PoseGraph
            The graph.
        poses : ndarray, (n, 3) or (n, 7)
            The minimum whose parts may be replaced.
        """
        i, j = graph.edge_indices.T
        other = self.poses
        steps = lie.local(lie.between(poses[i], poses[j]), lie.between(other[i], other[j]))
        apart = np.sqrt(np.square(steps[:, graph.dimension :]).sum(axis=1))
        if graph.dimension == 3:
            apart = 2 * np.arcsin(np.minimum(apart, 1.0))
        seen: set[bytes] = set()
        for limit in _DIFFERENT:
            nodes = np.zeros(len(poses), np.bool_)
            nodes[graph.edge_indices[apart > limit]] = True
            for part in connected_parts(graph, neighborhood(graph, nodes, _REACH)):
                key = _key(part)
                refused = self._refused.get(key)
                same = refused is not None and same_poses(refused, poses[neighborhood(graph, part)])
                if key not in seen and not same:
                    seen.add(key)
                    yield part

    def refuse(self, part: Flags, graph: PoseGraph, poses: Floats) -> None:
        """Remember that a part did not lower chi2 at these poses of all nodes."""
        self._refused[_key(part)] = poses[neighborhood(graph, part)]


def same_poses(some: Floats, others: Floats) -> bool:
    """Return whether poses are the same but for what optimizers leave and rounding makes."""
    return bool(np.abs(lie.local(some, others)).max() < _SAME_POSE)


def same_minimum(some: Floats, others: Floats) -> bool:
    """Return whether poses, (n, 3) or (n, 7), lead to the same minimum.

    In 2D the rotations tell: given them, the translations have one minimum. In 3D there are minima
    whose rotations hardly differ.
    """
    if some.shape[1] != 3:
        return same_poses(some, others)
    turns = (some[:, 2] - others[:, 2]) / (2 * np.pi)
    return bool(np.abs(turns - np.round(turns)).max() < _SAME_ROTATION / (2 * np.pi))


def _key(part: Flags) -> bytes:
    return np.packbits(part).tobytes()


def spliced(part: Subgraph, other: Floats) -> Floats:
    """Return the poses of a part with those of another minimum inside.

    The other minimum is moved as a whole so that it fits the fixed nodes around the part.

    Parameters
    ----------
    part : Subgraph
        The part, at the poses of one minimum.
    other : ndarray, (n, 3) or (n, 7)
        The other minimum's poses of all nodes of the whole graph.
    """
    graph, inside = part.graph, part.inside
    assert graph.poses is not None
    theirs = other[part.nodes]
    out = graph.poses.copy()
    border = np.flatnonzero(~inside)
    if len(border) == 0:
        out[inside] = theirs[inside]
        return out
    d = 2 if out.shape[1] == 3 else 3
    # The rotation nearest to those that fit one node each, and the mean position.
    moves = lie.to_matrices(lie.compose(out[border], lie.inverse(theirs[border])))
    turn = _core.nearest_rotations(np.ascontiguousarray(moves[:, :d, :d].mean(axis=0)[None]))
    moved = lie.compose(turn, theirs)
    moved[:, :d] += (out[border, :d] - moved[border, :d]).mean(axis=0)
    out[inside] = moved[inside]
    return out
