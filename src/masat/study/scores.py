"""How good a map is that was made in spite of false loop closures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from masat import lie
from masat.arrays import Flags, Floats
from masat.chain import odometry_edges
from masat.evaluation.alignment import similarity
from masat.graph import PoseGraph
from masat.quantiles import GATE
from masat.residuals import chi2_per_edge

MAX_RATIO = 1.05
"""A map succeeds whose cost exceeds that of the clean map by no more than this factor."""


@dataclass(frozen=True)
class Scores:
    """A map and the loop closures kept in it, against the clean map: that of the true edges alone.

    Attributes
    ----------
    true_closures, true_kept : int
        Number of true loop closures, and how many of them were kept.
    false_closures, false_kept : int
        Number of false loop closures, and how many of them were kept.
    cost_ratio : float
        Truncated cost of the true edges over that of the clean map: the chi2 of odometry, and the
        chi2 of each true loop closure up to the 99.9 % quantile of an honest one.
    chi2_ratio : float
        chi2 of the true edges over that of the clean map.
    rmse : float
        Root mean square distance of the positions from those of the clean map, in meters, after the
        best rigid alignment.
    """

    true_closures: int
    true_kept: int
    false_closures: int
    false_kept: int
    cost_ratio: float
    chi2_ratio: float
    rmse: float

    @property
    def success(self) -> bool:
        """Whether the truncated cost is that of the clean map, within 5 %."""
        return self.cost_ratio <= MAX_RATIO

    @property
    def strict_success(self) -> bool:
        """Whether chi2 of the true edges is that of the clean map, within 5 %."""
        return self.chi2_ratio <= MAX_RATIO

    @property
    def precision(self) -> float | None:
        """Fraction of the kept loop closures that are true; None if none were kept."""
        kept = self.true_kept + self.false_kept
        return self.true_kept / kept if kept else None

    @property
    def recall(self) -> float | None:
        """Fraction of the true loop closures that were kept; None if there are none."""
        return self.true_kept / self.true_closures if self.true_closures else None


def score(
    clean: PoseGraph, graph: PoseGraph, is_false: Flags, kept: Flags, poses: Floats
) -> Scores:
    """Compare a map of a graph with false loop closures with the clean map.

    Parameters
    ----------
    clean : PoseGraph
        The true edges of the graph in their order, at their optimum.
    graph : PoseGraph
        The graph with the false loop closures.
    is_false : ndarray of bool, (m,)
        Which of its edges are false.
    kept : ndarray of bool, (m,)
        Which of its edges were kept.
    poses : ndarray, (n, 3) or (n, 7)
        The map.
    """
    assert clean.poses is not None
    closures = ~odometry_edges(graph)
    true, false = closures & ~is_false, closures & is_false
    own = true[~is_false]
    best, found = chi2_per_edge(clean, clean.poses), chi2_per_edge(clean, poses)
    # A clean map of exact measurements has a chi2 of zero.
    tiny = np.finfo(np.float64).tiny
    gate = GATE[graph.dof]
    return Scores(
        true_closures=int(true.sum()),
        true_kept=int((true & kept).sum()),
        false_closures=int(false.sum()),
        false_kept=int((false & kept).sum()),
        cost_ratio=_truncated(found, own, gate) / max(_truncated(best, own, gate), tiny),
        chi2_ratio=float(found.sum()) / max(float(best.sum()), tiny),
        rmse=_aligned_rmse(poses[:, : clean.dimension], clean.poses[:, : clean.dimension]),
    )


def _truncated(chi2: Floats, closures: Flags, gate: float) -> float:
    return float(chi2[~closures].sum() + np.minimum(chi2[closures], gate).sum())


def _aligned_rmse(positions: Floats, reference: Floats) -> float:
    """Return the root mean square distance after the best rotation and translation."""
    transform, _ = similarity(positions, reference)
    d = positions.shape[1]
    points = np.tile(lie.identity(3), (len(positions), 1))
    points[:, :d] = positions
    off = lie.compose(transform, points)[:, :d] - reference
    return float(np.sqrt((off**2).sum(axis=1).mean()))
