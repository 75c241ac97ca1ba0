"""Maps with landmarks, from arrays to the minimum, beside gtsam from the same initial guess.

gtsam has no factor of a point seen in the frame of a pose that Python can make without callbacks.
Its times are those of its bearing-range factors, whose variances are those of the point to first
order. Then its own optimizer goes on, off the clock, to the minimum of the chi2 that masat
minimizes. All maps are judged by masat's evaluation of it.

In the worlds "-bearings" range and bearing were measured: gtsam's factors have masat's residual,
and its minimum is that from the truth.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from time import perf_counter
from typing import Any

import gtsam
import numpy as np

import masat
from benchmarks.paths import settled
from benchmarks.threads import single_threaded
from benchmarks.with_gtsam import poses_of
from masat import lie
from masat.arrays import Floats, Ids
from masat.residuals import measured_poses
from masat.worlds import WORLDS
from masat.worlds.landmarks import ranges_and_bearings

# Meters and radians a step of odometry; meters a coordinate of an observation.
_STEP, _TURN, _SEEN = 0.02, 0.005, 0.1
# Radians of a bearing.
_BEARING = 0.01
_REPEATS, _LIMIT = 3, 50


def park(rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return 7,000 poses of a drive through a park, and 150 trees."""
    poses = np.zeros((7000, 3))
    for k in range(1, len(poses)):
        x, y, heading = poses[k - 1]
        home = np.arctan2(-y, -x) - heading
        back = 0.05 * np.sign(np.sin(home)) if np.hypot(x, y) > 80 else 0.0
        heading += rng.normal(scale=0.08) + back
        poses[k] = x + 0.6 * np.cos(heading), y + 0.6 * np.sin(heading), heading
    poses[:, 2] = np.angle(np.exp(1j * poses[:, 2]))
    return poses, rng.uniform(poses[:, :2].min(), poses[:, :2].max(), size=(150, 2))


def sphere(rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return 2,500 poses on a sphere and 20,000 points around them."""
    poses = WORLDS["sphere"](2500, 2510, seed=0).poses
    assert poses is not None
    near = poses[rng.integers(len(poses), size=20_000), :3]
    return poses, near + rng.normal(scale=3.0, size=near.shape)


_WORLDS: dict[str, tuple[Callable[[np.random.Generator], tuple[Floats, Floats]], int]] = {
    "park": (park, 10_000),
    "sphere": (sphere, 80_000),
}
_WORLDS |= {f"{name}-bearings": _WORLDS[name] for name in ("park", "sphere")}


def world(name: str) -> tuple[masat.PoseGraph, masat.PoseGraph]:
    """Return the odometry of a world and what its poses saw, and the same at the truth.

    Each point is seen from some of the poses nearest to it.
    """
    rng = np.random.default_rng(0)
    make, count = _WORLDS[name]
    poses, points = make(rng)
    d, n = points.shape[1], len(poses)
    each = -(-count // len(points))
    pairs = np.concatenate(
        [
            np.column_stack([rng.choice(_nearest(poses[:, :d], point, 4 * each), each), [k] * each])
            for k, point in enumerate(points)
        ]
    )
    pairs = np.unique(pairs[rng.permutation(len(pairs))[:count]], axis=0)
    there = np.tile(lie.identity(d), (len(pairs), 1))
    there[:, :d] = points[pairs[:, 1]]
    seen = lie.between(poses[pairs[:, 0]], there)[:, :d]
    information = 1 / _SEEN**2 * np.eye(d)
    with_bearings = name.endswith("-bearings")
    if with_bearings:
        information = np.diag([1 / _SEEN**2] + [1 / _BEARING**2] * (d - 1))
    sigmas = np.repeat([_STEP, _TURN], [d, lie.DOF[d] - d])
    steps = lie.between(poses[:-1], poses[1:])
    measured = lie.retract(steps, rng.normal(size=(n - 1, lie.DOF[d])) * sigmas)
    noise = rng.normal(size=seen.shape)
    z = seen + _SEEN * noise
    if with_bearings:
        z = ranges_and_bearings(seen, noise / np.sqrt(np.diag(information)))
    graph = masat.PoseGraph.from_arrays(
        np.column_stack([np.arange(n - 1), np.arange(1, n)]),
        measured,
        np.diag(1 / np.square(sigmas)),
        landmarks=masat.landmarks(
            pairs + np.array([0, n]), z, information, range_bearing=with_bearings
        ),
    )
    return graph, graph.with_poses(poses).with_points(points[graph.point_ids - n])


def _nearest(positions: Floats, point: Floats, count: int) -> Ids:
    return np.argpartition(np.square(positions - point).sum(axis=1), count)[:count]


class _Peer:
    """gtsam's factors and values of a graph with landmarks."""

    def __init__(self, graph: masat.PoseGraph) -> None:
        self._graph, self._d = graph, graph.dimension
        self._pose = gtsam.Pose2 if self._d == 2 else gtsam.Pose3

    def relative(self) -> Any:
        """Return the factors of the edges, the first node held."""
        graph = self._graph
        factors = gtsam.NonlinearFactorGraph()
        between = gtsam.BetweenFactorPose2 if self._d == 2 else gtsam.BetweenFactorPose3
        prior = gtsam.PriorFactorPose2 if self._d == 2 else gtsam.PriorFactorPose3
        # A rotation vector comes first, and is twice the part of the quaternion.
        sigmas = [_STEP, _STEP, _TURN] if self._d == 2 else [2 * _TURN] * 3 + [_STEP] * 3
        noise = gtsam.noiseModel.Diagonal.Sigmas(np.array(sigmas))
        for (a, b), z in zip(graph.edges.tolist(), graph.measurements, strict=True):
            factors.add(between(a, b, self._of(z), noise))
        held = gtsam.noiseModel.Isotropic.Sigma(graph.dof, 1e-4)
        factors.add(prior(0, self._of(lie.identity(self._d)), held))
        return factors

    def bearings(self) -> Any:
        """Return the factors of the edges and one of bearing and range for each observation."""
        factors = self.relative()
        seen = self._graph.landmarks
        assert seen is not None
        positions = measured_poses(seen)[:, : self._d]
        for (a, b), z in zip(seen.observations.tolist(), positions, strict=True):
            distance = float(np.linalg.norm(z))
            across = _SEEN / distance if seen.range_bearing is None else _BEARING
            off = [across] * (self._d - 1)
            noise = gtsam.noiseModel.Diagonal.Sigmas(np.array([*off, _SEEN]))
            if self._d == 2:
                bearing = gtsam.Rot2.fromAngle(float(np.arctan2(z[1], z[0])))
                factors.add(gtsam.BearingRangeFactor2D(a, b, bearing, distance, noise))
            else:
                factors.add(gtsam.BearingRangeFactor3D(a, b, gtsam.Unit3(z), distance, noise))
        return factors

    def points(self) -> tuple[Any, Any]:
        """Return factors whose minimum is that of chi2, and values to add for them.

        In 3D the point in the frame of the pose is a variable with half the variance; the other
        half is that between it and the landmark. Together they weigh as one, exactly. In 2D, where
        gtsam has no such factor, each is a function in Python.
        """
        factors, more = self.relative(), gtsam.Values()
        seen = self._graph.landmarks
        assert seen is not None
        noise = gtsam.noiseModel.Isotropic.Sigma(self._d, _SEEN)
        half = gtsam.noiseModel.Isotropic.Sigma(self._d, _SEEN / 2**0.5)
        own = len(self._graph) + len(seen)
        for (a, b), z in zip(seen.observations.tolist(), seen.measurements, strict=True):
            if self._d == 2:
                factors.add(gtsam.CustomFactor(noise, [a, b], self._error(a, b, z)))
                continue
            factors.add(gtsam.ReferenceFrameFactorPoint3Pose3(own, a, b, half))
            factors.add(gtsam.PriorFactorPoint3(own, z, half))
            more.insert(own, z)
            own += 1
        return factors, more

    def values(self) -> Any:
        """Return the poses and points of the graph."""
        values = gtsam.Values()
        graph = self._graph
        assert graph.poses is not None
        assert graph.points is not None
        for k, pose in enumerate(graph.poses):
            values.insert(k, self._of(pose))
        for k, point in zip(graph.point_ids.tolist(), graph.points, strict=True):
            values.insert(k, point)
        return values

    def graph_at(self, values: Any) -> masat.PoseGraph:
        """Return the graph at gtsam's values."""
        read = values.atPoint2 if self._d == 2 else values.atPoint3
        points = np.array([read(k) for k in self._graph.point_ids.tolist()])
        return self._graph.with_poses(poses_of(values, self._d)).with_points(points)

    def _of(self, pose: Floats) -> Any:
        if self._d == 2:
            return gtsam.Pose2(*pose)
        x, y, z, w = pose[3:]
        return gtsam.Pose3(gtsam.Rot3.Quaternion(w, x, y, z), pose[:3])

    def _error(self, a: int, b: int, z: Floats) -> Callable[[Any, Any, Any], Floats]:
        def error(this: Any, values: Any, jacobians: Any) -> Floats:
            pose, point = values.atPose2(a), values.atPoint2(b)
            by_pose, by_point = np.zeros((2, 3), order="F"), np.zeros((2, 2), order="F")
            e = pose.transformTo(point, by_pose, by_point) - z
            if jacobians is not None:
                jacobians[0], jacobians[1] = by_pose, by_point
            return np.asarray(e)

        return error


def _optimized(factors: Any, values: Any, method: str) -> tuple[Any, int]:
    """Return gtsam's minimum and its iterations."""
    if method == "GN":
        solver = gtsam.GaussNewtonOptimizer(factors, values, gtsam.GaussNewtonParams())
    else:
        solver = gtsam.LevenbergMarquardtOptimizer(
            factors, values, gtsam.LevenbergMarquardtParams()
        )
    history = [solver.error()]
    while len(history) <= _LIMIT:
        solver.iterate()
        history.append(solver.error())
        if settled(*history[-2:]):
            break
    return solver.values(), len(history) - 1


def main() -> None:
    """Print the table."""
    single_threaded()
    print("arrays to map, best of the repeats in s; gtsam from masat's chordal guess, which is not")
    print("in its time; ratio of masat's time to gtsam's, wanted at most 0.33")
    print("world           solver                    its  seconds  ratio                chi2")
    for name in sys.argv[1:] or _WORLDS:
        graph, truth = world(name)
        took = []
        for _ in range(_REPEATS):
            start = perf_counter()
            result = masat.solve(graph, threads=1)
            took.append(perf_counter() - start)
        ours = min(took)
        print(f"{name:15} masat                         {ours:8.2f}        {result.chi2:19.10g}")
        peer = _Peer(masat.initialize(graph, "chordal"))
        factors, minimum = peer.bearings(), None
        # Where Gauss-Newton arrives it is the faster of the two.
        for method in ("GN", "LM"):
            start = perf_counter()
            try:
                found, count = _optimized(factors, peer.values(), method)
            except RuntimeError as error:
                print(f"{name:15} gtsam {method} fails: {str(error).splitlines()[0][:70]}")
                continue
            seconds = perf_counter() - start
            chi2, minimum = peer.graph_at(found).chi2, found
            print(
                f"{name:15} gtsam {method}                 {count:4d} {seconds:8.2f} "
                f"{ours / seconds:6.3f} {chi2:19.10g}",
                flush=True,
            )
            break
        if graph.landmarks is not None and graph.landmarks.range_bearing is not None:
            found, _ = _optimized(factors, _Peer(truth).values(), "LM")
            chi2 = peer.graph_at(found).chi2
            print(f"{name:15} gtsam, from the truth                         {chi2:19.10g}")
        elif minimum is not None:
            points, more = peer.points()
            minimum.insert(more)
            chi2 = peer.graph_at(_optimized(points, minimum, "GN")[0]).chi2
            print(
                f"{name:15} gtsam, residual of a point                     {chi2:19.10g}",
                flush=True,
            )


if __name__ == "__main__":
    main()
