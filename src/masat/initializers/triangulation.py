"""Positions of landmarks of which ranges and bearings were measured, for an initial guess.

An observation of range and bearing becomes one of the position: that is the same to first order,
and every initializer can use it. Landmarks of which bearings alone or ranges alone were measured
are placed at fixed poses: several candidates are moved to the nearest minimum of their own
residuals, and the best is taken. Drift of the poses misplaces some of them, but few enough that a
map that fits the others shows where they are.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from masat import _core
from masat.arrays import Flags, Floats, Ids
from masat.freedoms import degrees_of_freedom
from masat.graph import PoseGraph
from masat.information import partial
from masat.measurements import Landmarks
from masat.optimizers import optimize
from masat.progress import Progress
from masat.residuals import directions, measured_poses, observation_errors

# Steps of a candidate, and the damping at which they begin, as a fraction of the information.
_STEPS, _DAMPING = 30, 1e-3
# Rays or positions whose spread in a direction is a smaller fraction of that in the others count as
# parallel, or as in a line or plane.
_PARALLEL = 1e-6
# Another position is as good if its chi2 is larger by less: of two, one that is worse by this much
# is right in one case of 20.
_AS_GOOD = 6.0
# It is another one if it is so many standard deviations away, squared.
_ELSEWHERE = 100.0
# Rays are followed over so many steps of odometry where no range tells how far.
_USUAL_STEPS = 10.0
_MAX_NOTES = 5
# The losses of the maps after each of which the landmarks are placed again, and their iterations.
_LOSSES, _ITERATIONS = (None, None, "cauchy", None), 30
# chi2 of a good map is within so many standard deviations of its mean.
_PLAUSIBLE = 5.0


def as_positions(graph: PoseGraph) -> Landmarks | None:
    """Return the landmarks of a graph, each observation of range and bearing as one of a position.

    Observations without information in some direction of range and bearing are left out, and so are
    landmarks that nothing else measures.
    """
    seen = graph.landmarks
    assert seen is not None
    polar = seen.is_range_bearing
    open_ = np.zeros(len(polar), np.bool_)
    open_[partial(seen.information)] = True
    information = seen.information.copy()
    which = np.flatnonzero(polar & ~open_)
    if len(which):
        z, w = seen.measurements[which], information[which]
        # A range that is smaller than its standard deviation says nothing about what lies across.
        at = np.zeros_like(z)
        at[:, 0] = np.maximum(z[:, 0], 1 / np.sqrt(w[:, 0, 0]))
        _, jacobian = _core.range_bearing_errors(at, np.ascontiguousarray(at[:, 0]))
        jacobian = jacobian @ _core.rotation_matrices(directions(z)).transpose(0, 2, 1)
        w = jacobian.transpose(0, 2, 1) @ w @ jacobian
        information[which] = 0.5 * (w + w.transpose(0, 2, 1))
    keep = ~(polar & open_)
    pairs = seen.observations[keep]
    measured = np.isin(seen.ids, pairs[:, 1])
    if graph.priors is not None:
        measured |= np.isin(seen.ids, graph.priors.ids)
    if not measured.any():
        return None
    return Landmarks(
        seen.ids[measured],
        None if seen.positions is None else seen.positions[measured],
        pairs,
        measured_poses(seen)[keep, : seen.dimension],
        information[keep],
    )


def with_points(
    graph: PoseGraph, known: PoseGraph, progress: Progress | None = None
) -> tuple[PoseGraph, list[str]]:
    """Return a graph of which poses are known with positions of all its landmarks, and notes.

    Where some landmarks had to be triangulated, the poses are improved with them.

    Parameters
    ----------
    graph : PoseGraph
        The graph.
    known : PoseGraph
        The same with poses, and with positions of those landmarks that `as_positions` left.
    progress : Progress, optional
        What limits the time.
    """
    seen = graph.landmarks
    assert seen is not None
    d = graph.dimension
    points = np.zeros((len(seen), d)) if seen.positions is None else seen.positions.copy()
    if known.points is not None:
        points[np.searchsorted(seen.ids, known.point_ids)] = known.points
    assert known.poses is not None
    guess = graph.with_poses(known.poses).with_points(points)
    chosen = _to_triangulate(graph)
    if not chosen.any():
        return guess, []
    guess, notes = _triangulated(guess, chosen)
    best, freedom = guess, degrees_of_freedom(guess) + _unmeasured(seen, chosen)
    for loss in _LOSSES:
        if is_plausible(best.chi2, freedom) or (progress is not None and progress.over):
            break
        fit = optimize(guess, loss=loss, max_iterations=_ITERATIONS, progress=progress)
        assert fit.graph.points is not None
        moved = guess.with_poses(fit.poses).with_points(fit.graph.points)
        guess, found = _triangulated(moved, chosen)
        if guess.chi2 < best.chi2:
            best, notes = guess, found
    return best, notes


def is_plausible(chi2: float, freedom: int) -> bool:
    """Whether chi2 of a map is that of a good one, given its degrees of freedom."""
    return bool(chi2 < freedom + _PLAUSIBLE * np.sqrt(2 * max(freedom, 1)))


def _unmeasured(seen: Landmarks, chosen: Flags) -> int:
    """Return how many coordinates of some landmarks their observations are too few to determine."""
    at = np.searchsorted(seen.ids, seen.observations[:, 1])
    ranks = np.linalg.matrix_rank(seen.information, hermitian=True)
    measured = np.bincount(at, ranks, len(seen))[chosen]
    return int(np.maximum(seen.dimension - measured, 0).sum())


def _triangulated(graph: PoseGraph, chosen: Flags) -> tuple[PoseGraph, list[str]]:
    """Return the graph with some of its landmarks placed at its poses, and notes."""
    assert graph.points is not None
    assert graph.poses is not None
    assert graph.landmarks is not None
    points, seen = graph.points.copy(), graph.landmarks
    rows = np.isin(seen.observations[:, 1], seen.ids[chosen])
    seen = replace(seen.observed(rows), ids=seen.ids[chosen], positions=None)
    steps = np.sqrt(np.square(graph.measurements[:, : graph.dimension]).sum(axis=1))
    found = triangulated(
        seen,
        graph.poses[graph.index(seen.observations[:, 0])],
        usual=_USUAL_STEPS * float(np.median(steps[steps > 0])) if steps.any() else 1.0,
    )
    points[chosen] = found.points
    return graph.with_points(points), found.notes


def _to_triangulate(graph: PoseGraph) -> Flags:
    """Tell which landmarks have observations, but none that measures a position in full."""
    seen = graph.landmarks
    assert seen is not None
    full = np.ones(len(seen.observations), np.bool_)
    full[partial(seen.information)] = False
    placed = seen.observations[full, 1]
    if graph.priors is not None:
        d, priors = graph.dimension, graph.priors
        own = np.ascontiguousarray(priors.information[:, :d, :d])
        placed = np.concatenate([placed, np.delete(priors.ids, partial(own))])
    polar = seen.observations[seen.is_range_bearing, 1]
    return np.isin(seen.ids, polar) & ~np.isin(seen.ids, placed)


class Triangulated(NamedTuple):
    """Landmarks at fixed poses.

    Attributes
    ----------
    points : ndarray, (k, d)
        The best positions.
    information : ndarray, (k, d, d)
        Their information, the poses being known.
    doubtful : ndarray of bool, (k,)
        Which of them have another position that is as good.
    notes : list of str
        Sentences about these.
    """

    points: Floats
    information: Floats
    doubtful: Flags
    notes: list[str]


def triangulated(seen: Landmarks, poses: Floats, usual: float) -> Triangulated:
    """Place landmarks that no single observation places.

    Parameters
    ----------
    seen : Landmarks
        The observations.
    poses : ndarray, (l, 3) or (l, 7)
        The known pose of each observation.
    usual : float
        Distance in meters at which to look for a landmark where no range tells how far it is.
    """
    return _Triangulation(seen, poses, usual).result()


class _Triangulation:
    """Landmarks that no single observation places, and what is seen of them from known poses."""

    def __init__(self, seen: Landmarks, poses: Floats, usual: float) -> None:
        self._ids, self._seen, self._poses, self._usual = seen.ids, seen, poses, usual
        self._at = np.searchsorted(self._ids, seen.observations[:, 1])
        self._d, self._count = seen.dimension, len(self._ids)

    def result(self) -> Triangulated:
        """Return the best positions, and notes where others are as good."""
        found = [self._refined(candidate) for candidate in self._candidates()]
        points = np.stack([points for points, _, _ in found])
        costs = np.stack([cost for _, cost, _ in found])
        best, every = np.argmin(costs, axis=0), np.arange(self._count)
        nearest = points[best, every]
        information = np.stack([h for _, _, h in found])[best, every]
        apart = points - nearest
        far = np.einsum("cki,kij,ckj->ck", apart, information, apart) > _ELSEWHERE
        far &= np.linalg.eigvalsh(information)[:, 0] > 0
        rival = np.where(far & (costs < costs[best, every] + _AS_GOOD), costs, np.inf)
        second = np.argmin(rival, axis=0)
        doubtful = np.flatnonzero(np.isfinite(rival[second, every]))
        notes = [
            f"landmark {self._ids[k]}: two positions fit what was measured of it about as well, "
            f"{_text(nearest[k])} and {_text(points[second[k], k])}: the initial guess has the "
            "first. A bearing, or a range from off the line of the others would decide"
            for k in doubtful[:_MAX_NOTES]
        ]
        if len(doubtful) > _MAX_NOTES:
            notes.append(
                f"two positions fit what was measured of {len(doubtful) - _MAX_NOTES} more "
                "landmarks about as well"
            )
        return Triangulated(nearest, information, np.isfinite(rival[second, every]), notes)

    def _candidates(self) -> list[Floats]:
        """Return positions to begin at, each (k, d)."""
        d, seen = self._d, self._seen
        own = np.einsum("kii->ki", seen.information) > 0
        polar = seen.is_range_bearing
        ranged, aimed = polar & own[:, 0], polar & own[:, 1]
        where = self._poses[:, :d]
        middle = self._mean(where, np.ones(len(polar), np.bool_))
        distance = self._mean(seen.measurements[:, :1], ranged)
        distance[~np.isfinite(distance)] = self._usual
        into = _core.rotation_matrices(np.ascontiguousarray(self._poses))
        along = _core.rotation_matrices(directions(seen.measurements))[:, :, 0]
        ray = np.einsum("kij,kj->ki", into, along)
        ahead = self._mean(ray, aimed)
        ahead[~np.isfinite(ahead[:, 0])] = np.eye(d)[0]
        length = np.sqrt(np.square(ahead).sum(axis=1, keepdims=True))
        # In the mean direction; where rays are opposite that of the x axis.
        straight = middle + distance * np.where(length > 0, ahead / np.maximum(length, 1e-9), 0)
        out = [straight]
        if aimed.any():
            out.append(self._crossing(where, ray, aimed, straight))
        if ranged.any():
            out += self._ranged(where, seen.measurements[:, 0], ranged, straight)
        return out

    def _crossing(self, where: Floats, ray: Floats, rows: Flags, otherwise: Floats) -> Floats:
        """Return the positions nearest to the rays."""
        across = np.eye(self._d) - ray[:, :, None] * ray[:, None, :]
        middle = self._mean(where, rows)
        middle[~np.isfinite(middle)] = 0
        a = self._sum(across, rows)
        b = self._sum(np.einsum("kij,kj->ki", across, where - middle[self._at]), rows)
        values, vectors = np.linalg.eigh(a)
        open_ = values <= _PARALLEL * np.maximum(values[:, -1:], 1e-300)
        inverse = np.where(open_, 0, 1 / np.where(open_, 1, values))
        crossing = middle + np.einsum("kij,kj,klj,kl->ki", vectors, inverse, vectors, b)
        return np.where(open_.any(axis=1)[:, None], otherwise, crossing)

    def _ranged(
        self, where: Floats, ranges: Floats, rows: Flags, otherwise: Floats
    ) -> list[Floats]:
        """Return the positions that fit ranges, and the two across the flattest direction."""
        count = np.bincount(self._at[rows], minlength=self._count)
        middle = self._mean(where, rows)
        middle[~np.isfinite(middle)] = 0
        own = where - middle[self._at]
        squared = np.square(own).sum(axis=1) - np.square(ranges)
        a = self._sum(own[:, :, None] * own[:, None, :], rows)
        b = self._sum(own * squared[:, None], rows) / 2
        values, vectors = np.linalg.eigh(a)
        turned = np.einsum("kji,kj->ki", vectors, b)
        open_ = values <= _PARALLEL * np.maximum(values[:, -1:], 1e-300)
        offsets = np.where(open_, 0, turned / np.where(open_, 1, values))
        flat = offsets.copy()
        flat[:, 0] = 0
        in_plane = np.einsum("kij,kj->ki", vectors, flat)
        left = np.square(ranges) - np.square(own - in_plane[self._at]).sum(axis=1)
        height = np.sqrt(np.maximum(self._mean(left[:, None], rows)[:, 0], 0))
        out = [middle + np.einsum("kij,kj->ki", vectors, offsets)]
        out += [middle + in_plane + (s * height)[:, None] * vectors[:, :, 0] for s in (1, -1)]
        return [np.where(count[:, None] > 0, points, otherwise) for points in out]

    def _refined(self, points: Floats) -> tuple[Floats, Floats, Floats]:
        """Return where Levenberg-Marquardt leads from candidates, chi2 and information there."""
        d = self._d
        damping = np.full(self._count, _DAMPING)
        cost, gradient, information = self._system(points)
        for _ in range(_STEPS):
            scale = np.einsum("kii->k", information)
            scale = damping * np.where(scale > 0, scale, 1)
            step = np.linalg.solve(
                information + scale[:, None, None] * np.eye(d), gradient[..., None]
            )[..., 0]
            moved = points - step
            there = self._system(moved)
            lower = there[0] < cost
            damping = np.clip(np.where(lower, damping / 5, damping * 5), 1e-12, 1e12)
            points = np.where(lower[:, None], moved, points)
            cost = np.where(lower, there[0], cost)
            gradient = np.where(lower[:, None], there[1], gradient)
            information = np.where(lower[:, None, None], there[2], information)
        return points, cost, information

    def _system(self, points: Floats) -> tuple[Floats, Floats, Floats]:
        """Return chi2 of each landmark, half its gradient and half its approximate Hessian."""
        e, jacobians = observation_errors(self._seen, self._poses, points[self._at])
        w = self._seen.information
        back = jacobians.transpose(0, 2, 1) @ w
        every = np.ones(len(e), np.bool_)
        return (
            self._sum(np.einsum("ki,kij,kj->k", e, w, e), every),
            self._sum(np.einsum("kij,kj->ki", back, e), every),
            self._sum(back @ jacobians, every),
        )

    def _sum(self, values: Floats, rows: Flags) -> Floats:
        """Return the sum of the values of each landmark, of some observations."""
        out = np.zeros((self._count, *values.shape[1:]))
        np.add.at(out, self._at[rows], values[rows])
        return out

    def _mean(self, values: Floats, rows: Flags) -> Floats:
        """Return the mean of each landmark, not a number where it has no such observation."""
        count: Ids = np.bincount(self._at[rows], minlength=self._count)
        total = self._sum(values, rows)
        mean: Floats = np.where(count[:, None] > 0, total / np.maximum(count, 1)[:, None], np.nan)
        return mean


def _text(point: Floats) -> str:
    return "(" + ", ".join(f"{value:.4g}" for value in point) + ")"
