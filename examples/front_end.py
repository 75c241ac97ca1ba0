"""A SLAM front end whose back end is masat, in the shape of KISS-SLAM.

KISS-SLAM (PRBonn/kiss-slam) keeps a graph of local maps in an optimizer with five methods:
`add_variable`, `fix_variable`, `add_factor`, `optimize` and `estimates`, with 4x4 matrices.
`PoseGraphOptimizer` below has these on top of `masat.OnlineMap`, so that a front end which is
written for it runs unchanged. `FrontEnd` is such a front end, for beacons that a sensor recognizes:
it registers each scan to the last one, begins a local map every few meters, and closes loops where
it sees beacons again.

    python examples/front_end.py
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

import masat

Matrix = NDArray[np.float64]
Scan = dict[int, NDArray[np.float64]]
"""Positions of beacons in the frame of the sensor, by their ids."""

_RECENT = 10  # local maps before the current one, in which no loop is closed


class PoseGraphOptimizer:
    """The back end: poses by id, factors between them."""

    def __init__(self) -> None:
        self._map = masat.OnlineMap(3)

    def add_variable(self, node: int, pose: Matrix) -> None:
        """Add a pose with its initial guess, a 4x4 matrix."""
        self._map.add_pose(node, masat.lie.from_matrices(pose))

    def fix_variable(self, node: int) -> None:
        """Fix a pose. An `OnlineMap` fixes the first one of each component by itself."""
        if len(self._map.ids) and node != self._map.ids[0]:
            raise ValueError(f"only the first pose can be fixed, not {node}")

    def add_factor(self, source: int, target: int, motion: Matrix, information: Matrix) -> None:
        """Add a measured pose of `target` in the frame of `source`."""
        self._map.add_edges((source, target), masat.lie.from_matrices(motion), information)

    def optimize(self) -> None:
        """Bring all poses up to date; this costs a small fraction of a whole solve."""
        self._map.update()

    @property
    def estimates(self) -> dict[int, Matrix]:
        """The poses as 4x4 matrices, by id."""
        matrices = masat.lie.to_matrices(self._map.poses)
        return dict(zip(self._map.ids.tolist(), matrices, strict=True))

    def graph(self) -> masat.PoseGraph:
        """Return the graph, to write, to view or to solve as a whole."""
        return self._map.graph()


class FrontEnd:
    """Registers scans, one after the other, and keeps a graph of local maps.

    Parameters
    ----------
    spacing : float
        Meters after which a local map begins.
    common : int
        Least number of beacons that a scan must share with an old one to close a loop.
    """

    def __init__(self, spacing: float = 2.0, common: int = 10) -> None:
        self.optimizer = PoseGraphOptimizer()
        self.closures: list[tuple[int, int]] = []
        self._spacing, self._common = spacing, common
        self._scans: list[Scan] = []  # the first scan of each local map
        self._last: Scan = {}
        self._motion = np.eye(4)  # since the local map began

    @property
    def pose(self) -> Matrix:
        """Where the sensor is now, as a 4x4 matrix."""
        return self.optimizer.estimates[len(self._scans) - 1] @ self._motion

    def process(self, scan: Scan) -> None:
        """Take a scan."""
        if not self._scans:
            self._begin_local_map(scan, np.eye(4))
            self.optimizer.fix_variable(0)
        else:
            self._motion = self._motion @ registered(self._last, scan)
            if np.linalg.norm(self._motion[:3, 3]) > self._spacing:
                self._begin_local_map(scan, self.pose)
        self._last = scan

    def _begin_local_map(self, scan: Scan, pose: Matrix) -> None:
        new = len(self._scans)
        self.optimizer.add_variable(new, pose)
        if new > 0:
            self.optimizer.add_factor(new - 1, new, self._motion, np.eye(6))
        # The local map that shows most of the same beacons, but for those just left behind.
        shared = [len(old.keys() & scan.keys()) for old in self._scans[:-_RECENT]]
        if shared and max(shared) >= self._common:
            old = int(np.argmax(shared))
            self.optimizer.add_factor(old, new, registered(self._scans[old], scan), np.eye(6))
            self.closures.append((old, new))
        self._scans.append(scan)
        self._motion = np.eye(4)
        self.optimizer.optimize()


def registered(one: Scan, other: Scan) -> Matrix:
    """Return the pose of the other scan in the frame of the one, from the beacons of both.

    Source: Umeyama, Least-squares estimation of transformation parameters between two point
    patterns, PAMI 1991.
    """
    beacons = sorted(one.keys() & other.keys())
    to = np.array([one[k] for k in beacons])
    points = np.array([other[k] for k in beacons])
    center, from_center = to.mean(axis=0), points.mean(axis=0)
    u, _, v = np.linalg.svd((to - center).T @ (points - from_center))
    u[:, 2] *= np.linalg.det(u @ v)
    motion = np.eye(4)
    motion[:3, :3] = u @ v
    motion[:3, 3] = center - motion[:3, :3] @ from_center
    return motion


def drive(laps: float = 2.2, seed: int = 1) -> Iterator[tuple[Matrix, Scan]]:
    """Simulate a drive on a hilly circle: yield true poses and noisy scans of beacons."""
    random = np.random.default_rng(seed)
    angles = random.uniform(0, 2 * np.pi, 300)
    radii = 20 + random.uniform(-6, 6, 300)
    beacons = np.column_stack(
        [radii * np.cos(angles), radii * np.sin(angles), random.uniform(-1, 5, 300)]
    )
    for a in np.arange(0, laps * 2 * np.pi, 0.025):
        pose = np.eye(4)
        pose[:3, :3] = [[-np.sin(a), -np.cos(a), 0], [np.cos(a), -np.sin(a), 0], [0, 0, 1]]
        pose[:3, 3] = 20 * np.cos(a), 20 * np.sin(a), np.sin(3 * a)
        local = (beacons - pose[:3, 3]) @ pose[:3, :3]
        seen = np.flatnonzero(np.linalg.norm(local, axis=1) < 8)
        noisy = local[seen] + random.normal(0, 0.15, (len(seen), 3))
        yield pose, dict(zip(seen.tolist(), noisy, strict=True))


def main() -> None:
    """Run the front end, and compare its path with the truth and with odometry alone."""
    front_end, truth, path = FrontEnd(), [], [np.eye(4)]
    previous: Scan = {}
    for pose, scan in drive():
        front_end.process(scan)
        truth.append(pose)
        if previous:
            path.append(path[-1] @ registered(previous, scan))
        previous = scan
    true_motion = np.linalg.inv(truth[0]) @ truth[-1]
    for name, end in (("odometry", path[-1]), ("with loop closures", front_end.pose)):
        error = np.linalg.norm(end[:3, 3] - true_motion[:3, 3])
        print(f"{name}: {error:.2f} m from where the drive ended")
    graph = front_end.optimizer.graph()
    print(graph, f"with {len(front_end.closures)} loop closures")
    masat.view(graph, "front_end.html")


if __name__ == "__main__":
    main()
