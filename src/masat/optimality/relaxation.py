"""The chordal problem of a pose graph, and its solution by way of lifted ranks.

The chordal cost of poses (R, t) is the sum over the edges of

    kappa |R_j - R_i R|^2 + tau |t_j - t_i - R_i t|^2,

with isotropic surrogates kappa and tau of the information matrices. In 3D it equals chi2 where
these are isotropic; in 2D it counts 2 (1 - cos e) instead of e^2 for an error e of a heading.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from masat import _core, linear
from masat.arrays import Floats, Indices
from masat.errors import InitializationError
from masat.graph import PoseGraph

# A gap below this share of the cost counts as none.
TIGHT = 1e-3
# Shifts of the certificate, as shares of the cost an unknown: four times as much is their part of
# the gap.
_SHIFTS = (1e-8, TIGHT / 4)
# How far below zero, as a share of the median weight of a rotation, the certificate's eigenvalues
# may lie at a plausible minimum: at .1 m and rad of noise those of the study's global minima mostly
# lie within the first. Farther than the second they mark the places where minima differ.
_PLAUSIBLE, _WEAK = 5e-4, 0.02
_POLISHING = 60
# The rank to lift to: in 2D one column more leaves local minima that two do not; in 3D the blocks
# of a second one would be too large.
_LIFTED_RANK = 4
_NOISE = 0.3
# Bytes of a factor that a higher rank may take.
_MOST_MEMORY = 4e9


@dataclass(frozen=True)
class Point:
    """Lifted poses and their chordal cost.

    Attributes
    ----------
    unknowns : ndarray, (n, d + 1, p)
        X_i = [Y_i t_i]': an orthonormal frame of d rows of p numbers, and a translation.
    cost : float
    """

    unknowns: Floats
    cost: float

    @property
    def rank(self) -> int:
        """The p."""
        return int(self.unknowns.shape[2])


class Relaxation:
    """The chordal problem of a graph, for frames of any rank; the anchors hold still.

    Sources: Rosen, Carlone, Bandeira, Leonard, SE-Sync, IJRR 2019; Boumal, A Riemannian
    low-rank method for optimization over semidefinite matrices, 2015.
    """

    def __init__(self, graph: PoseGraph) -> None:
        self.graph = graph
        self.weights = linear.isotropic_weights(graph)
        self._free = graph.elimination.free_nodes()
        self._held = graph.index(graph.gauge)
        self._matrix = _core.GraphMatrix(graph.elimination, graph.dimension + 1)
        self._scale = float(np.median(self.weights.rotation)) if len(graph.edges) else 1.0

    @property
    def nothing(self) -> float:
        """A cost at which typical edges fit to a millionth of a radian: none, to all purposes."""
        return 1e-12 * self._scale * len(self.graph.edges)

    def cost(self, x: Floats) -> float:
        """Return the cost of unknowns, summed over the edges."""
        d, z = self.graph.dimension, self.graph.measurements
        i, j = self.graph.edge_indices.T
        y, t = x[:, :d], x[:, d]
        turned = _core.rotation_matrices(z).transpose(0, 2, 1) @ y[i]
        gone = t[i] + (z[:, None, :d] @ y[i])[:, 0]
        turns = self.weights.rotation @ np.square(y[j] - turned).sum(axis=(1, 2))
        return float(turns + self.weights.translation @ np.square(t[j] - gone).sum(axis=1))

    def unknowns(self, poses: Floats, rank: int) -> Floats:
        """Return the unknowns of poses, (n, d + 1, rank)."""
        d = self.graph.dimension
        x = np.zeros((len(poses), d + 1, rank))
        x[:, :d, :d] = linear.rotations(poses)
        x[:, d, :d] = poses[:, :d]
        return x

    def minimize(self, x: Floats, *, decrease: float, damping: float, steps: int = 100) -> Point:
        """Go down from x to where a Newton step promises less than a share of the cost."""
        if len(self._free) == 0:
            return Point(x, self.cost(x))
        held_alone = x.copy()
        held_alone[self._free] = 0
        solved, failed = _core.minimize_lifted(
            self._matrix,
            self._assemble(x),
            self.cost(held_alone),
            np.ascontiguousarray(x[self._free]),
            decrease,
            damping * self._scale,
            steps,
        )
        if failed >= 0:
            raise InitializationError(
                f"the edges around node {self.graph.ids[self._free[failed]]} do not determine it"
            )
        out = x.copy()
        out[self._free] = solved
        return Point(out, self.cost(out))

    def polish(self, poses: Floats) -> Point:
        """Go down from poses, at their own rank."""
        x = self.unknowns(poses, self.graph.dimension)
        return self.minimize(x, decrease=1e-7, damping=1e-2, steps=_POLISHING)

    def can_lift(self) -> bool:
        """Whether memory allows a higher rank."""
        return self.lifted_bytes() <= _MOST_MEMORY

    def lifted_bytes(self) -> int:
        """Return the size of a factor at the higher rank."""
        d = self.graph.dimension
        return 8 * self.graph.elimination.fill(_core.lifted_block_size(d, _LIFTED_RANK))

    def lift(self, x: Floats, rng: np.random.Generator) -> Floats:
        """Return unknowns of a higher rank, the new columns filled with smooth noise."""
        d, old = self.graph.dimension, x.shape[2]
        out = np.zeros((*x.shape[:2], _LIFTED_RANK))
        out[:, :, :old] = x
        self._assemble(out)
        damping = np.tile([5e-4 * self._scale] * d + [0.0], len(self._free))
        broken = self._matrix.factorize(damping)
        if broken >= 0:
            raise InitializationError(
                f"the edges around node {self.graph.ids[self._free[broken]]} do not determine it"
            )
        noise = rng.normal(size=(len(self._free), d + 1, _LIFTED_RANK - old))
        smooth = self._matrix.solve(noise)
        out[self._free, :, old:] = smooth * (_NOISE / np.sqrt(np.square(smooth[:, :d]).mean()))
        return out

    def minimize_lifted(self, x: Floats, *, decrease: float, seed: int) -> Point:
        """Go down from x in a higher rank, entered by noise."""
        lifted = self.lift(x, np.random.default_rng(seed))
        return self.minimize(lifted, decrease=decrease, damping=30.0)

    def gap(self, point: Point) -> float:
        """Return how far any poses may lie below the cost of a point; inf if no bound is known."""
        if len(self._free) == 0:
            return 0.0
        d = self.graph.dimension
        share = max(point.cost, self.nothing) / (len(self._free) * (d + 1))
        own = np.ascontiguousarray(point.unknowns[self._free])
        forcing = self._assemble(point.unknowns)
        gaps = (
            _core.certificate_gap(self._matrix, forcing, own, shift * share, 0.0)
            for shift in _SHIFTS
        )
        return next((gap for gap in gaps if np.isfinite(gap)), np.inf)

    def plausible(self, poses: Floats) -> bool:
        """Whether a minimum looks global, without a proof: its certificate fails by little."""
        return len(self._failing(poses, _PLAUSIBLE)) == 0

    def weak_places(self, poses: Floats) -> Indices:
        """Return places in `ids`, one or more wherever the certificate of a minimum fails."""
        return self._free[self._failing(poses, _WEAK)]

    def _failing(self, poses: Floats, share: float) -> Indices:
        if len(self._free) == 0:
            return self._free
        x = self.unknowns(poses, self.graph.dimension)
        own = np.ascontiguousarray(x[self._free])
        return _core.uncertified_nodes(self._matrix, self._assemble(x), own, share * self._scale)

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
            # The anchors' frames lie in the first d columns: turn the rest back to them.
            left, _, right = np.linalg.svd(
                np.einsum("kij,kil->jl", flat[self._held, :d], x[self._held, :d, :d])
            )
            flat = flat @ (left @ right)
        start = np.zeros((len(x), 3 if d == 2 else 7))
        start[:, :d] = flat[:, d]
        held = np.ascontiguousarray(x[self._held, :d, :d].transpose(0, 2, 1))
        start[self._held] = _core.nearest_rotations(held)
        start[self._held, :d] = x[self._held, d, :d]
        return linear.nearest_rotations(self.graph, start, np.ascontiguousarray(flat[:, :d]))

    def _assemble(self, x: Floats) -> Floats:
        """Set the matrix; return what the held nodes make of the right-hand side."""
        graph, weights = self.graph, self.weights
        return self._matrix.assemble_poses(
            graph.topology, graph.measurements, weights.rotation, weights.translation, x
        )


@dataclass(frozen=True)
class Solution:
    """Poses of low chordal cost, and what can be said of all others.

    Attributes
    ----------
    poses : ndarray, (n, 3) or (n, 7)
    cost : float
        Their chordal cost.
    bound : float
        No poses have a lower one; 0, which none can have, if no better bound was found.
    nothing : float
        A cost that is as good as none (`Relaxation.nothing`).
    rank : int
        The highest rank gone to.
    """

    poses: Floats
    cost: float
    bound: float
    nothing: float
    rank: int

    @property
    def certified(self) -> bool:
        """Whether the cost is proven to be the least, to `TIGHT` of itself or to nothing."""
        return self.cost - self.bound <= max(TIGHT * self.cost, self.nothing)


def solve(
    graph: PoseGraph,
    poses: Floats,
    *,
    lift: bool = True,
    seed: int = 0,
) -> Solution:
    """Minimize the chordal cost from poses on, in a higher rank where their own leaves doubt.

    A certificate bounds how far the minimum may lie above the global one. Where it leaves a gap,
    the poses are lifted: columns of noise are added to their frames, which opens ways out of local
    minima. The minimum there, rounded to rotations, leads back to poses; its own certificate may
    tighten the bound. Source: as of `Relaxation`.

    Parameters
    ----------
    graph : PoseGraph
        The graph.
    poses : ndarray, (n, 3) or (n, 7)
        Where to begin, the anchors at their places.
    lift : bool
        Whether to go to a higher rank at all.
    seed : int
        Of the noise.

    Returns
    -------
    Solution
    """
    relaxed = Relaxation(graph)
    best = top = relaxed.polish(poses)
    bound = best.cost - relaxed.gap(best)
    known = best.cost - bound <= max(TIGHT * best.cost, relaxed.nothing)
    if lift and not known and relaxed.can_lift():
        top = relaxed.minimize_lifted(best.unknowns, decrease=1e-6, seed=seed)
        bound = max(bound, top.cost - relaxed.gap(top))
        rounded = relaxed.polish(relaxed.poses(top.unknowns))
        if rounded.cost < best.cost:
            best = rounded
            bound = max(bound, best.cost - relaxed.gap(best))
    solved = relaxed.poses(best.unknowns)
    held = graph.index(graph.gauge)
    solved[held] = poses[held]
    # Rounding errors may lift the bound above the cost.
    bound = min(max(bound, 0.0), best.cost)
    return Solution(solved, best.cost, bound, relaxed.nothing, top.rank)
