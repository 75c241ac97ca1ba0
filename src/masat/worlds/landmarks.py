"""Simulated landmarks along a walk, and what the poses near them saw."""

from __future__ import annotations

import numpy as np

from masat import lie
from masat.arrays import Floats, Ids
from masat.errors import GraphError
from masat.graph import PoseGraph
from masat.measurements import landmarks
from masat.residuals import as_poses, directions
from masat.worlds.closures import MAX_COUNT, check_integers, check_seed
from masat.worlds.fixes import check_length, true_poses
from masat.worlds.noise import ZERO_SIGMA

# Average number of observations of a landmark, and how many each has at least, where poses are
# near enough.
_USUAL, _LEAST = 10, 2
# A landmark is within this fraction of the reach from the pose that it is drawn near, so that the
# poses before and after see it, too.
_NEAR = 0.7
# Distances that are computed at once.
_BATCH = 10**6


def add_landmarks(
    graph: PoseGraph,
    count: int,
    *,
    sigma: float = 0.1,
    sigma_bearing: float | None = None,
    reach: float = 8.0,
    observations: int | None = None,
    seed: int = 0,
) -> PoseGraph:
    """Add landmarks near the walk, with observations from poses within reach, to a known map.

    Each landmark is drawn near a random pose. It is observed from at least two poses, where as
    many are within reach.

    Parameters
    ----------
    graph : PoseGraph
        A graph with its true poses and without landmarks.
    count : int
        Number of landmarks.
    sigma : float
        Standard deviation of each coordinate of an observation, in meters. A sigma of 0 leaves the
        observations exact, with the information of `ZERO_SIGMA`.
    sigma_bearing : float, optional
        Standard deviation of a direction in radians: range and bearing are observed in the place of
        coordinates, and `sigma` is that of the range.
    reach : float
        Largest distance at which a pose observes a landmark, in meters.
    observations : int, optional
        Number of observations, drawn at random from those within reach. Default: ten a landmark,
        or as many as are within reach.
    seed : int
        Seed of the random numbers. Positions and observed pairs do not depend on `sigma`.

    Returns
    -------
    PoseGraph
        The graph with landmarks at their true positions. Their ids follow those of the poses.

    Raises
    ------
    GraphError
        If the graph has no poses, or has landmarks; if a count is not an integer, or there are too
        few pairs within reach; or if sigma, reach or seed is negative or not a number.
    """
    check_integers(count=count, observations=0 if observations is None else observations)
    check_length("the sigma of observations", sigma)
    check_length("the sigma of bearings", sigma_bearing or 0.0)
    check_length("the reach of observations", reach)
    check_seed(seed)
    poses = true_poses(graph, "landmarks")
    if graph.landmarks is not None:
        raise GraphError("the graph has landmarks: simulate all of them at once")
    if not 0 <= count <= MAX_COUNT or reach == 0:
        raise GraphError(
            f"the number of landmarks must not be negative, and their reach not 0; got {count} and "
            f"{reach:g} m"
        )
    if count == 0:
        return graph
    d, random = graph.dimension, np.random.default_rng([seed, 4])
    near = poses[random.integers(len(poses), size=count), :d]
    direction = random.normal(size=(count, d))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    # Uniform in the circle or ball.
    distance = _NEAR * reach * random.random(count) ** (1 / d)
    points = near + distance[:, None] * direction
    pairs = _drawn(_within_reach(poses[:, :d], points, reach), count, observations, random)
    at = np.tile(lie.identity(d), (len(pairs), 1))
    at[:, :d] = points[pairs[:, 1]]
    seen, noise = lie.between(poses[pairs[:, 0]], at)[:, :d], random.normal(size=(len(pairs), d))
    sigmas = np.full(d, sigma)
    if sigma_bearing is None:
        seen = seen + sigma * noise
    else:
        sigmas[1:] = sigma_bearing
        seen = ranges_and_bearings(seen, sigmas * noise)
    ids = int(graph.ids[-1]) + 1 + np.arange(count)
    return graph.with_landmarks(
        landmarks(
            np.column_stack([graph.ids[pairs[:, 0]], ids[pairs[:, 1]]]),
            seen,
            np.diag(1 / np.square(np.where(sigmas > 0, sigmas, ZERO_SIGMA))),
            ids=ids,
            positions=points,
            range_bearing=sigma_bearing is not None,
        )
    )


def ranges_and_bearings(points: Floats, noise: Floats) -> Floats:
    """Return range, bearing and in 3D elevation of points seen with noise.

    Parameters
    ----------
    points : ndarray, (l, 2) or (l, 3)
        In the frame of the sensor.
    noise : ndarray, (l, 2) or (l, 3)
        Errors of the range in meters and of the direction in radians, to the left and up.
    """
    d = points.shape[1]

    def spherical(of: Floats) -> Floats:
        flat = np.hypot(of[:, 0], of[:, 1])
        angles = [np.arctan2(of[:, 1], of[:, 0]), np.arctan2(of[:, 2:].sum(axis=1), flat)]
        return np.stack([np.linalg.norm(of, axis=1), *angles[: d - 1]], axis=1)

    exact = spherical(points)
    turned = np.linalg.norm(noise[:, 1:], axis=1)
    ahead = np.column_stack([np.cos(turned), noise[:, 1:] * np.sinc(turned / np.pi)[:, None]])
    out = spherical(lie.compose(directions(exact), as_poses(ahead))[:, :d])
    out[:, 0] = np.abs(exact[:, 0] + noise[:, 0])
    return out


def _within_reach(positions: Floats, points: Floats, reach: float) -> Ids:
    """Return the pairs (pose, point), (c, 2), at most `reach` apart, sorted by point."""
    step = max(1, _BATCH // len(positions))
    found = []
    for begin in range(0, len(points), step):
        apart = points[begin : begin + step, None] - positions
        point, pose = np.nonzero(np.einsum("ijk,ijk->ij", apart, apart) <= reach**2)
        found.append(np.column_stack([pose, begin + point]))
    return np.concatenate(found)


def _drawn(pairs: Ids, count: int, wanted: int | None, random: np.random.Generator) -> Ids:
    """Draw pairs, the first ones of each point before all others, in the order of the poses."""
    if wanted is None:
        wanted = min(_USUAL * count, len(pairs))
    if not 0 <= wanted <= len(pairs):
        raise GraphError(
            f"{len(pairs)} pairs of a pose and a landmark are within reach, but {wanted} "
            "observations are asked for; ask for fewer, or for a longer reach"
        )
    order = random.permutation(len(pairs))
    by_point = order[np.argsort(pairs[order, 1], kind="stable")]
    first = np.searchsorted(pairs[by_point, 1], np.arange(count))
    rank = np.empty(len(pairs), np.int64)
    rank[by_point] = np.arange(len(pairs)) - first[pairs[by_point, 1]]
    chosen = pairs[order[np.argsort(np.minimum(rank[order], _LEAST), kind="stable")[:wanted]]]
    in_time: Ids = chosen[np.lexsort((chosen[:, 1], chosen[:, 0]))]
    return in_time
