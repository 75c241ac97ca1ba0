"""The relaxation of a surrogate cost to frames of a higher rank, its minima and its bounds.

The unknown X of a node has four rows of p numbers: those of its frame, then those of its
translation. In 3D X = [Y t]', with an orthonormal frame of three rows; poses have p = 3. In 2D a
rotation is a complex number of unit length, a frame p of them whose squared lengths sum to one, and
a translation p complex numbers, real and imaginary parts a row each; poses have p = 1. As matrices
of two rows the rotations would have a weaker relaxation, to which a reflection is a rotation too.

Sources: Rosen, Carlone, Bandeira, Leonard, SE-Sync, IJRR 2019; Carlone, Calafiore, Tommolillo,
Dellaert, Planar pose graph optimization: duality, optimal solutions, and verification, IEEE T-RO
2016; Fan, Wang, Rubenstein, Murphey, CPL-SLAM, IEEE T-RO 2020; Boumal, A Riemannian low-rank method
for optimization over semidefinite matrices, 2015.
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
# eigenvalues may lie at a minimum that looks global. Beyond the second they mark where minima
# differ; beyond the third, at 0.35 m and rad of noise, none of the study's global minima has any.
_PLAUSIBLE, _UNCERTIFIED, _REFUTED = 5e-4, 0.02, 0.2
# Diagonal entries, as a fraction of themselves, that a certificate can spare: what the rounding of
# its factorization may hide.
_ROUNDING_MARGIN = 1e-13
_POLISHING_STEPS = 60
# Numbers of a row, by dimension: of poses, and where the relaxation is minimized.
_RANK, _LIFTED_RANK = {2: 1, 3: 3}, {2: 2, 3: 4}
# Rows of an unknown.
_ROWS = 4
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
    unknowns : ndarray, (n, 4, p)
        The X of each node: a frame of d rows, then its translation.
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
        self._matrix = _core.GraphMatrix(graph.elimination, _ROWS)
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
        ahead, there = _core.lifted_poses(z) @ x[i], x[j]
        offsets = self.graph.sensor_offsets
        if offsets is not None:
            there = _core.lifted_poses(offsets) @ there
        cost = float(tau @ np.square(there[:, d:] - ahead[:, d:]).sum(axis=(1, 2)))
        # A rotation matrix has the squared length d, the frames of poses that of their unit rows.
        scale = d / _RANK[d]
        if a.ndim == 1:
            return cost + scale * float(a @ np.square(there[:, :d] - ahead[:, :d]).sum(axis=(1, 2)))
        own = np.square(there[:, :d]).sum(axis=(1, 2)) + np.square(x[i, :d]).sum(axis=(1, 2))
        joint = np.einsum("kab,kac,kbc->k", a, ahead[:, :d], there[:, :d])
        return cost + float(np.einsum("kii->k", a) / d @ own - 2 * joint.sum())

    def unknowns(self, poses: Floats) -> Floats:
        """Return the unknowns of poses, (n, 4, p)."""
        return np.ascontiguousarray(_core.lifted_poses(poses)[:, :, : _RANK[self.graph.dimension]])

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
        return self.minimize(
            self.unknowns(poses), decrease=1e-7, damping=1e-2, steps=_POLISHING_STEPS
        )

    def can_lift(self) -> bool:
        """Whether memory allows a higher rank."""
        size = _core.lifted_block_size(_LIFTED_RANK[self.graph.dimension])
        return 8 * self.graph.elimination.fill(size) <= _MAX_FACTOR_BYTES

    def lift(self, x: Floats, rng: np.random.Generator) -> Floats:
        """Return unknowns of a higher rank, the new columns filled with smooth noise."""
        d, old = self.graph.dimension, x.shape[2]
        rank = _LIFTED_RANK[d]
        out = np.zeros((*x.shape[:2], rank))
        out[:, :, :old] = x
        self._assemble(out)
        damping = np.zeros((len(self._free), _ROWS))
        damping[:, :d] = (5e-4 * self._scale + self._excess()[self._free])[:, None]
        failed = self._matrix.factorize(damping.ravel())
        if failed >= 0:
            raise linear.undetermined(self.graph, int(self._free[failed]))
        noise = rng.normal(size=(len(self._free), _ROWS, rank - old))
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
        x : ndarray, (n, 4, p)
            Unknowns near a minimum.
        allowed : float
            How much of the cost may be spent on a certificate matrix that fails by little: it is
            part of the gap.
        """
        if len(self._free) == 0:
            return 0.0
        own = np.ascontiguousarray(x[self._free])
        shift = allowed / (4 * _RANK[self.graph.dimension] * len(self._free))
        return _core.certificate_gap(self._matrix, self._assemble(x), own, shift, _ROUNDING_MARGIN)

    def plausible(self, poses: Floats) -> bool:
        """Whether a minimum looks global, without a proof: its certificate fails by little."""
        return len(self._failing(poses, _PLAUSIBLE)) == 0

    def doubtful_nodes(self, poses: Floats) -> Indices:
        """Return indices of nodes with which fixed the certificate of a minimum holds."""
        return self._free[self._failing(poses, 0.0)]

    def uncertified_nodes(self, poses: Floats) -> Indices:
        """Return indices of nodes, one or more wherever the certificate of a minimum fails."""
        return self._free[self._failing(poses, _UNCERTIFIED)]

    def refuted_nodes(self, poses: Floats) -> Indices:
        """Return indices of nodes, one or more wherever the certificate fails by much."""
        return self._free[self._failing(poses, _REFUTED)]

    def _failing(self, poses: Floats, fraction: float) -> Indices:
        if len(self._free) == 0:
            return self._free
        x = self.unknowns(poses)
        own = np.ascontiguousarray(x[self._free])
        return _core.uncertified_nodes(self._matrix, self._assemble(x), own, fraction * self._scale)

    def poses(self, x: Floats) -> Floats:
        """Return the poses nearest to unknowns of any rank, (n, 3) or (n, 7).

        Those of the fixed and gauge-fixed nodes are exactly the graph's.

        Raises
        ------
        InitializationError
            If the poses are not finite.
        """
        d = self.graph.dimension
        rank, fixed = _RANK[d], self._fixed
        # In 2D a row each of the rotations and the translations, of complex numbers.
        flat = x[:, ::2] + 1j * x[:, 1::2] if d == 2 else x
        if x.shape[2] > rank:
            held = flat[fixed, :rank, :rank]
            frames = flat[:, :rank].reshape(-1, x.shape[2])
            _, vectors = np.linalg.eigh(frames.conj().T @ frames)
            flat = flat @ vectors[:, : -rank - 1 : -1]
            if d == 3 and np.count_nonzero(np.linalg.det(flat[:, :d]) > 0) < len(x) / 2:
                flat[:, :, -1] *= -1
            # The fixed nodes' frames lie in the first columns: turn the rest back to them.
            left, _, right = np.linalg.svd(
                np.einsum("kij,kil->jl", flat[fixed, :rank].conj(), held)
            )
            flat = flat @ (left @ right)
        if d == 2:
            rotation, translation = flat[:, 0, 0], np.ascontiguousarray(flat[:, 1, 0])
            rows = np.stack([rotation.real, rotation.imag, -rotation.imag, rotation.real], axis=1)
            rows, positions = rows.reshape(-1, 2, 2), translation.view(np.float64).reshape(-1, 2)
        else:
            rows, positions = flat[:, :d], flat[:, d]
        assert self.graph.poses is not None
        known = self.graph.poses.copy()
        known[self._free, :d] = positions[self._free]
        poses = linear.nearest_rotations(self.graph, known, rows)
        if not np.isfinite(poses).all():
            raise InitializationError("the relaxation gave poses that are not finite")
        return poses

    def _assemble(self, x: Floats) -> Floats:
        """Set the matrix; return the linear term, which comes from the fixed nodes."""
        return self._matrix.assemble_poses(
            self.graph.topology, *self.surrogate[:3], x, self.graph.sensor_offsets
        )


def lifted_operations(graph: PoseGraph) -> float:
    """Return the operations of a factorization at the higher rank."""
    return graph.elimination.operations(_core.lifted_block_size(_LIFTED_RANK[graph.dimension]))


def polish(graph: PoseGraph) -> Floats:
    """Return the poses at the minimum of the chordal cost near those of a graph."""
    assert graph.poses is not None
    relaxation = Relaxation(graph)
    return relaxation.poses(relaxation.polish(graph.poses).unknowns)


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
    x = relaxation.unknowns(graph.poses)
    top = relaxation.minimize_lifted(x, decrease=_LIFTED_DECREASE, seed=seed)
    return solve_translations(graph, relaxation.poses(top.unknowns))
