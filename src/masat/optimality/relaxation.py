"""The relaxation of a surrogate cost to frames of a higher rank, its minima and its bounds.

Sources: Rosen, Carlone, Bandeira, Leonard, SE-Sync, IJRR 2019; Boumal, A Riemannian low-rank
method for optimization over semidefinite matrices, 2015.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from masat import _core, linear
from masat.arrays import Floats, Indices
from masat.errors import InitializationError
from masat.graph import PoseGraph
from masat.optimality.surrogates import Surrogate, chordal_surrogate
from masat.optimizers.translations import solve_translations

# How far below zero, as a fraction of the median weight of a rotation, the certificate's
# eigenvalues may lie at a minimum that looks global: at 0.1 m and rad of noise those of the study's
# global minima mostly lie within the first. Beyond the second they mark where minima differ; beyond
# the third, at 0.35 m and rad of noise, none of those lies.
_PLAUSIBLE, _UNCERTIFIED, _REFUTED = 5e-4, 0.02, 0.2
# Diagonal entries, as a fraction of themselves, that a certificate can spare: what the rounding of
# its factorization may hide.
_ROUNDING_MARGIN = 1e-13
_POLISHING_STEPS = 60
# In 2D two more dimensions leave local minima that one does not; in 3D the blocks of a second one
# would be too large.
_LIFTED_RANK = 4
_NOISE = 0.3
# A step at the higher rank that promises less than this fraction of the cost is the last one
# before poses are rounded. Fewer steps leave poses from which as many lower minima are found.
_LIFTED_DECREASE = 1e-3
# Bytes of a factor that a higher rank may take.
_MAX_FACTOR_BYTES = 4e9


@dataclass(frozen=True)
class Point:
    """Lifted poses and their cost.

    Attributes
    ----------
    unknowns : ndarray, (n, d + 1, p)
        X_i = [Y_i t_i]': an orthonormal frame of d rows of p numbers, and a translation.
    cost : float
        Their cost, without the surrogate's constant.
    """

    unknowns: Floats
    cost: float


class Relaxation:
    """The relaxation of a surrogate of a graph's chi2, for frames of any rank.

    Fixed and gauge-fixed nodes keep their poses.

    Parameters
    ----------
    graph : PoseGraph
        The graph.
    surrogate : Surrogate, optional
        Default: the chordal cost.
    """

    def __init__(self, graph: PoseGraph, surrogate: Surrogate | None = None) -> None:
        self.graph = graph
        self.surrogate = surrogate or chordal_surrogate(graph)
        self._free = graph.elimination.free_nodes()
        self._fixed = graph.index(graph.gauge)
        self._matrix = _core.GraphMatrix(graph.elimination, graph.dimension + 1)
        rotation = self.surrogate.rotation
        if rotation.ndim == 3:
            rotation = np.linalg.norm(rotation, axis=(1, 2)) / graph.dimension**0.5
        # What measures no rotation does not tell the scale.
        measured = rotation[rotation > 0]
        self._scale = float(np.median(measured)) if len(measured) else 1.0

    def cost(self, x: Floats) -> float:
        """Return the cost of unknowns, summed over the edges."""
        d, (z, a, tau, _) = self.graph.dimension, self.surrogate
        i, j = self.graph.edge_indices.T
        y_i, t_i, y_j, t_j = x[i, :d], x[i, d], x[j, :d], x[j, d]
        offsets = self.graph.sensor_offsets
        if offsets is not None:
            t_j = t_j + (offsets[:, None, :d] @ y_j)[:, 0]
            y_j = _core.rotation_matrices(offsets).transpose(0, 2, 1) @ y_j
        turn = _core.rotation_matrices(z)
        moved = t_i + (z[:, None, :d] @ y_i)[:, 0]
        cost = float(tau @ np.square(t_j - moved).sum(axis=1))
        if a.ndim == 1:
            turned = turn.transpose(0, 2, 1) @ y_i
            return cost + float(a @ np.square(y_j - turned).sum(axis=(1, 2)))
        own = np.square(y_i).sum(axis=(1, 2)) + np.square(y_j).sum(axis=(1, 2))
        joint = np.einsum("kab,kac,kbc->k", turn @ a, y_i, y_j)
        scale = np.einsum("kii->k", a) / d
        return cost + float(scale @ own - 2 * joint.sum())

    def unknowns(self, poses: Floats, rank: int) -> Floats:
        """Return the unknowns of poses, (n, d + 1, rank)."""
        d = self.graph.dimension
        x = np.zeros((len(poses), d + 1, rank))
        x[:, :d, :d] = linear.transposed_rotations(poses)
        x[:, d, :d] = poses[:, :d]
        return x

    def minimize(self, x: Floats, *, decrease: float, damping: float, steps: int = 100) -> Point:
        """Descend from x until a Newton step promises less than a fraction of the cost."""
        if len(self._free) == 0:
            return Point(x, self.cost(x))
        only_fixed = x.copy()
        only_fixed[self._free] = 0
        solved, failed = _core.minimize_lifted(
            self._matrix,
            self._assemble(x),
            self.cost(only_fixed),
            np.ascontiguousarray(x[self._free]),
            decrease,
            damping * self._scale,
            steps,
        )
        if failed >= 0:
            raise linear.undetermined(self.graph, int(self._free[failed]), "position")
        out = x.copy()
        out[self._free] = solved
        return Point(out, self.cost(out))

    def polish(self, poses: Floats) -> Point:
        """Descend from poses, at their own rank."""
        x = self.unknowns(poses, self.graph.dimension)
        return self.minimize(x, decrease=1e-7, damping=1e-2, steps=_POLISHING_STEPS)

    def can_lift(self) -> bool:
        """Whether memory allows a higher rank."""
        size = _core.lifted_block_size(self.graph.dimension, _LIFTED_RANK)
        return 8 * self.graph.elimination.fill(size) <= _MAX_FACTOR_BYTES

    def lift(self, x: Floats, rng: np.random.Generator) -> Floats:
        """Return unknowns of a higher rank, the new columns filled with smooth noise."""
        d, old = self.graph.dimension, x.shape[2]
        out = np.zeros((*x.shape[:2], _LIFTED_RANK))
        out[:, :, :old] = x
        self._assemble(out)
        damping = np.zeros((len(self._free), d + 1))
        damping[:, :d] = (5e-4 * self._scale + self._excess()[self._free])[:, None]
        failed = self._matrix.factorize(damping.ravel())
        if failed >= 0:
            raise linear.undetermined(self.graph, int(self._free[failed]))
        noise = rng.normal(size=(len(self._free), d + 1, _LIFTED_RANK - old))
        smooth = self._matrix.solve(noise)
        out[self._free, :, old:] = smooth * (_NOISE / np.sqrt(np.square(smooth[:, :d]).mean()))
        return out

    def _excess(self) -> Floats:
        """Return what each node, (n,), needs on its diagonal for the matrix to be semidefinite.

        The node blocks hold tr(A) / d, less than the norm of A where A is anisotropic.
        """
        a, n = self.surrogate.rotation, len(self.graph)
        if a.ndim == 1:
            return np.zeros(n)
        norm = np.linalg.norm(a, 2, axis=(1, 2))
        lacking = np.maximum(norm - np.einsum("kii->k", a) / self.graph.dimension, 0)
        i, j = self.graph.edge_indices.T
        return np.add(np.bincount(i, lacking, n), np.bincount(j, lacking, n))

    def minimize_lifted(self, x: Floats, *, decrease: float, seed: int) -> Point:
        """Descend from x at a higher rank, which noise opens."""
        lifted = self.lift(x, np.random.default_rng(seed))
        return self.minimize(lifted, decrease=decrease, damping=30.0)

    def gap(self, x: Floats, allowed: float = 0.0) -> float:
        """Return a number by which the cost of no poses lies below that of x, or infinity.

        Parameters
        ----------
        x : ndarray, (n, d + 1, p)
            Unknowns near a minimum.
        allowed : float
            How much of the cost may be spent on a certificate matrix that fails by little: it is
            part of the gap.
        """
        if len(self._free) == 0:
            return 0.0
        own = np.ascontiguousarray(x[self._free])
        shift = allowed / (4 * self.graph.dimension * len(self._free))
        return _core.certificate_gap(self._matrix, self._assemble(x), own, shift, _ROUNDING_MARGIN)

    def plausible(self, poses: Floats) -> bool:
        """Whether a minimum looks global, without a proof: its certificate fails by little."""
        return len(self._failing(poses, _PLAUSIBLE)) == 0

    def uncertified_nodes(self, poses: Floats) -> Indices:
        """Return indices of nodes, one or more wherever the certificate of a minimum fails."""
        return self._free[self._failing(poses, _UNCERTIFIED)]

    def refuted_nodes(self, poses: Floats) -> Indices:
        """Return indices of nodes, one or more wherever the certificate fails by much."""
        return self._free[self._failing(poses, _REFUTED)]

    def _failing(self, poses: Floats, fraction: float) -> Indices:
        if len(self._free) == 0:
            return self._free
        x = self.unknowns(poses, self.graph.dimension)
        own = np.ascontiguousarray(x[self._free])
        return _core.uncertified_nodes(self._matrix, self._assemble(x), own, fraction * self._scale)

    def poses(self, x: Floats) -> Floats:
        """Return the poses nearest to unknowns of any rank, (n, 3) or (n, 7)."""
        d = self.graph.dimension
        flat = x
        if x.shape[2] > d:
            frames = x[:, :d].reshape(-1, x.shape[2])
            _, vectors = np.linalg.eigh(frames.T @ frames)
            flat = x @ vectors[:, : -d - 1 : -1]
            if np.count_nonzero(np.linalg.det(flat[:, :d]) > 0) < len(flat) / 2:
                flat[:, :, -1] *= -1
            # The fixed nodes' frames lie in the first d columns: turn the rest back to them.
            left, _, right = np.linalg.svd(
                np.einsum("kij,kil->jl", flat[self._fixed, :d], x[self._fixed, :d, :d])
            )
            flat = flat @ (left @ right)
        initial = np.zeros((len(x), 3 if d == 2 else 7))
        initial[:, :d] = flat[:, d]
        frames = np.ascontiguousarray(x[self._fixed, :d, :d].transpose(0, 2, 1))
        initial[self._fixed] = _core.nearest_rotations(frames)
        initial[self._fixed, :d] = x[self._fixed, d, :d]
        return linear.nearest_rotations(self.graph, initial, np.ascontiguousarray(flat[:, :d]))

    def _assemble(self, x: Floats) -> Floats:
        """Set the matrix; return the linear term, which comes from the fixed nodes."""
        return self._matrix.assemble_poses(
            self.graph.topology, *self.surrogate[:3], x, self.graph.sensor_offsets
        )


def lifted_operations(graph: PoseGraph) -> float:
    """Return the operations of a factorization at the higher rank."""
    return graph.elimination.operations(_core.lifted_block_size(graph.dimension, _LIFTED_RANK))


def polish(graph: PoseGraph) -> Floats:
    """Return the poses at the minimum of the chordal cost near those of a graph."""
    assert graph.poses is not None
    relaxation = Relaxation(graph)
    return _with_fixed(graph, relaxation.poses(relaxation.polish(graph.poses).unknowns))


def lift(graph: PoseGraph, *, seed: int = 0) -> Floats:
    """Return poses to optimize from: rounded from a minimum of the chordal cost at a higher rank.

    Parameters
    ----------
    graph : PoseGraph
        A graph with poses.
    seed : int
        Seed of the random noise that is added when the rank is raised.

    Returns
    -------
    ndarray, (n, 3) or (n, 7)
        Where memory does not allow the higher rank, the poses of the graph.

    Raises
    ------
    InitializationError
        If the edges around a node do not determine it.
    """
    assert graph.poses is not None
    relaxation = Relaxation(graph)
    if not relaxation.can_lift():
        return graph.poses
    x = relaxation.unknowns(graph.poses, graph.dimension)
    top = relaxation.minimize_lifted(x, decrease=_LIFTED_DECREASE, seed=seed)
    return solve_translations(graph, _with_fixed(graph, relaxation.poses(top.unknowns)))


def _with_fixed(graph: PoseGraph, poses: Floats) -> Floats:
    """Return poses with those of the fixed and gauge-fixed nodes exactly as in the graph."""
    assert graph.poses is not None
    fixed = graph.index(graph.gauge)
    poses[fixed] = graph.poses[fixed]
    if not np.isfinite(poses).all():
        raise InitializationError("the relaxation gave poses that are not finite")
    return poses
