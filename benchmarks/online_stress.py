"""Random operations on a map that grows, valid ones and invalid ones, while threads read it.

    python -m benchmarks.online_stress [--operations N] [--seed N] [--readers N] [--nodes N]

Half of the operations are in 2D, half in 3D. After each update the map must hold what was added and
not removed; an operation that fails must raise an error of the package and change nothing; each
state that a reader sees must be one that an update left. At intervals the map is compared with the
batch solver, and saved and loaded. To run it under a sanitizer,
set PYTHONPATH and LD_PRELOAD as the Makefile's target `sanitize` does.
"""

from __future__ import annotations

import argparse
import hashlib
import tempfile
import threading
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

import masat
from masat import lie
from masat.arrays import Floats
from masat.worlds.landmarks import ranges_and_bearings

# A map of the default tolerance may exceed the batch optimum by this fraction of chi2, and by this
# much for each edge where measurements agree nearly exactly.
MAX_EXCESS, NEGLIGIBLE = 1e-2, 1e-6
_FAR = 1e9  # meters
_REACH = 10.0  # meters, of what sees landmarks


def digest(poses: Floats) -> bytes:
    """Return what tells one array of poses from another."""
    return hashlib.blake2b(poses.tobytes(), digest_size=16).digest()


def poses_of(core: Any) -> Floats:
    """Return the poses of a core's map, without its landmarks."""
    poses: Floats = core.poses()[~core.points()][1:]
    return poses


class RecordingCore:
    """The core of a map that keeps a digest of each state that it shows to readers."""

    def __init__(self, core: Any) -> None:
        self._core = core
        self.states = [digest(poses_of(core))]

    def __getattr__(self, name: str) -> Any:
        return getattr(self._core, name)

    def update(self, budget: float) -> Any:
        """Update the map and record its state."""
        done = self._core.update(budget)
        self.states.append(digest(poses_of(self._core)))
        return done

    def fill(self, **contents: Any) -> None:
        """Fill the map and record its state."""
        self._core.fill(**contents)
        self.states.append(digest(poses_of(self._core)))

    def set_poses(self, poses: Floats) -> None:
        """Move the map and record its state."""
        self._core.set_poses(poses)
        self.states.append(digest(poses_of(self._core)))


class RecordedMap(masat.OnlineMap):
    """A map whose states are recorded."""

    def _new_core(self) -> Any:
        return RecordingCore(super()._new_core())


class Readers:
    """Threads that read a map and check what they see."""

    def __init__(self, count: int) -> None:
        self.world: masat.OnlineMap | None = None
        self.errors: list[BaseException] = []
        self.reads = 0
        self._done = threading.Event()
        self._threads = [threading.Thread(target=self._run, args=(k,)) for k in range(count)]
        for thread in self._threads:
            thread.start()

    def stop(self) -> None:
        """End the threads; the first failed check of them is raised here."""
        self._done.set()
        for thread in self._threads:
            thread.join()
        if self.errors:
            raise self.errors[0]

    def _run(self, seed: int) -> None:
        random = np.random.default_rng(seed)
        try:
            while not self._done.is_set():
                if self.world is not None:
                    self._read(self.world, random)
                    self.reads += 1
                self._done.wait(0.001)  # the writer needs the interpreter, too
        except BaseException as error:
            self.errors.append(error)

    def _read(self, world: masat.OnlineMap, random: np.random.Generator) -> None:
        core: Any = world._core
        count, first = len(world), len(core.states) - 1
        poses = world.poses
        seen, after = digest(poses), len(core.states)
        assert count <= len(poses) <= len(world), "poses disappeared"
        check_poses(poses)
        current: Any = world._core
        if current is not core:
            return  # A review has put another map in its place.
        # The state of an update in progress is recorded shortly after it can be read.
        if seen not in core.states[first:after]:
            with world._writing:
                assert seen in core.states[first : after + 1], "a state that no update left"
        ids = world.ids
        assert len(ids) >= len(poses)
        assert repr(world).startswith(f"OnlineMap({world.dimension}D")
        if not len(poses):
            return
        some = random.choice(ids, 3)
        check_poses(np.stack([world.pose(int(node)) for node in some]))
        what = random.random()
        points = world.points
        assert points.shape[1] == world.dimension
        assert np.isfinite(points).all()
        if what < 0.2:
            assert np.isfinite(world.chi2)
        elif what < 0.4:
            check_covariances(world.covariances(some))
        elif what < 0.6:
            relative = world.relative_covariances(random.choice(ids, (2, 2)))
            # Where measurements are huge, so are levers, and their squares may overflow: no matter
            # whether an update has brought them before or after the poses were read.
            if max(np.abs(poses).max(), np.abs(world.poses).max()) < _FAR:
                check_covariances(relative)
        elif what < 0.65:
            graph = world.graph()
            assert np.isfinite(graph.chi2)
            assert len(graph) >= len(poses)


def check_poses(poses: Floats) -> None:
    """Assert that poses are finite and their quaternions of unit length."""
    assert np.isfinite(poses).all(), "poses that are not finite"
    if poses.shape[1] == 7:
        assert np.allclose(np.linalg.norm(poses[:, 3:], axis=1), 1, rtol=0, atol=1e-12)


def check_covariances(matrices: Floats) -> None:
    """Assert that matrices are finite, symmetric and positive semidefinite, up to rounding."""
    assert np.isfinite(matrices).all(), "covariances that are not finite"
    scale = np.abs(matrices).max(initial=1e-300)
    assert np.abs(matrices - matrices.transpose(0, 2, 1)).max(initial=0) <= 1e-9 * scale
    assert np.linalg.eigvalsh(matrices).min(initial=0) >= -1e-9 * scale, "negative covariances"


class Writer:
    """Random operations on a map, beside a plain account of what it must hold."""

    def __init__(
        self, dimension: int, seed: int, readers: Readers, most_nodes: int, max_excess: float
    ) -> None:
        self.dimension, self.dof = dimension, lie.DOF[dimension]
        self.random = np.random.default_rng(seed)
        self.readers, self.most_nodes, self.max_excess = readers, most_nodes, max_excess
        self.counts: Counter[str] = Counter()
        self.folder = tempfile.TemporaryDirectory()
        self.start()

    def start(self) -> None:
        """Begin another map."""
        self.watch(RecordedMap(self.dimension))
        self.truth: dict[int, Floats] = {}
        self.points: dict[int, Floats] = {}
        self.ids: list[int] = []  # of the last complete state, then those that wait
        self.complete_ids = 0
        self.edges: dict[int, tuple[int, int]] = {}  # of the last complete state
        self.added: dict[int, tuple[int, int]] = {}
        self.removed: list[int] = []

    def watch(self, world: masat.OnlineMap) -> None:
        """Let the readers read a map."""
        self.world = world
        self.readers.world = world

    def step(self) -> None:
        """Do one random operation."""
        kinds: list[tuple[float, Callable[[], None]]] = [
            (0.20, self.add_pose),
            (0.27, self.add_edges),
            (0.10, self.add_observations),
            (0.10, self.remove_edges),
            (0.12, self.fail),
            (0.24, self.update),
            (0.04, self.read_covariances),
            (0.01, self.update_in_vain),
            (0.005, self.optimize),
            (0.01, self.compare),
            (0.005, self.save_and_load),
        ]
        weights = np.array([weight for weight, _ in kinds])
        operation = kinds[self.random.choice(len(kinds), p=weights / weights.sum())][1]
        self.counts[operation.__name__] += 1
        operation()
        if len(self.ids) > self.most_nodes:
            self.update()
            self.compare()
            self.start()

    def add_pose(self) -> None:
        """Add a pose, most often with odometry to the one before."""
        node = int(self.random.integers(-(2**62), 2**62))
        step = self.random.normal(0, 0.3, self.dof)
        step[0] += 1
        last = self.truth[self.ids[-1]] if self.ids else lie.identity(self.dimension)
        pose = lie.retract(last[None], step[None])[0]
        self.world.add_pose(node, pose if self.random.random() < 0.3 else None)
        self.truth[node] = pose
        self.ids.append(node)
        if len(self.ids) > 1 and self.random.random() < 0.9:
            self.add(np.array([(self.ids[-2], node)]))

    def pairs(self, count: int) -> Any:
        """Return ids of nodes that are close to each other in time."""
        begin = self.random.integers(len(self.ids) - 1, size=count)
        gap = 1 + self.random.geometric(0.1, size=count)
        end = np.minimum(begin + gap, len(self.ids) - 1)
        pairs = np.array(self.ids)[np.column_stack([begin, end])]
        return self.random.permuted(pairs, axis=1)

    def add(self, pairs: Any) -> None:
        """Add edges with measurements that are true up to noise."""
        a, b = (np.stack([self.truth[int(node)] for node in end]) for end in pairs.T)
        z = lie.retract(lie.between(a, b), 0.02 * self.random.normal(size=(len(pairs), self.dof)))
        root = self.random.normal(size=(len(pairs), self.dof, self.dof))
        information = 100 * (root @ root.transpose(0, 2, 1) + np.eye(self.dof))
        information = (information + information.transpose(0, 2, 1)) / 2
        numbers = self.world.add_edges(pairs, z, information)
        self.added |= dict(zip(numbers.tolist(), map(tuple, pairs.tolist()), strict=True))

    def add_edges(self) -> None:
        """Add some edges between nodes of the map, and nodes that wait."""
        if len(self.ids) > 1:
            self.add(self.pairs(int(self.random.integers(1, 4))))

    def add_observations(self) -> None:
        """Let a pose see a landmark as a position, a range and a bearing, or a bearing alone."""
        if not self.ids:
            return
        d, pose = self.dimension, self.ids[-1 - int(self.random.geometric(0.2)) % len(self.ids)]
        near = [k for k, at in self.points.items() if self.distance(pose, at) < _REACH]
        if not near or self.random.random() < 0.2:
            point = int(self.random.integers(-(2**62), 2**62))
            self.points[point] = self.truth[pose][:d] + self.random.normal(0, 2, d)
        else:
            point = int(self.random.choice(near))
        there = lie.identity(d)[None]
        there[0, :d] = self.points[point]
        seen = lie.between(self.truth[pose][None], there)[:, :d]
        kind = self.random.integers(3)
        w = 1000.0 * np.eye(d)
        w[0, 0] *= kind < 2
        noise = 0.02 * self.random.normal(size=seen.shape)
        z = seen + noise if kind == 0 else ranges_and_bearings(seen, noise)
        numbers = self.world.add_observations(
            masat.landmarks([(pose, point)], z, w, range_bearing=bool(kind))
        )
        self.added[int(numbers[0])] = (pose, point)

    def distance(self, pose: int, point: Floats) -> float:
        """Return how far a pose is from a landmark."""
        return float(np.linalg.norm(self.truth[pose][: self.dimension] - point))

    def remove_edges(self) -> None:
        """Remove some edges or observations, which may wait themselves."""
        numbers = [n for n in [*self.edges, *self.added] if n not in self.removed]
        if len(numbers) > 2:
            some = self.random.choice(numbers, min(2, len(numbers)), replace=False).tolist()
            self.world.remove_edges(some)
            self.removed += some

    def fail(self) -> None:
        """Do something that must be refused."""
        w, size = self.world, lie.POSE_SIZE[self.dimension]
        node = self.ids[0] if self.ids else 0
        eye, z = np.eye(self.dof), lie.identity(self.dimension)
        calls: list[Callable[[], Any]] = [
            lambda: w.add_pose(5, np.full(size, np.nan)),
            lambda: w.add_pose(5, np.zeros(size + 1)),
            lambda: w.add_pose(2**63),
            lambda: w.add_edges((node, 5), z),
            lambda: w.add_edges((node, node), z),
            lambda: w.remove_edges(10**9),
            lambda: w.remove_edges(-1),
            lambda: w.covariances([5]),
            lambda: w.pose(5),
            lambda: w.relative_covariances([(node, 5)]),
            lambda: w.add_observations(masat.landmarks([(5, 6)], np.zeros((1, self.dimension)))),
            lambda: w.point(5),
            lambda: w.update(budget=np.nan),
            lambda: w.update(budget=-1.0),
        ]
        if len(self.ids) > 1:
            pair = self.pairs(1)
            two = np.concatenate([pair, pair])
            good = np.stack([z, z])
            calls += [
                lambda: w.add_pose(node),
                lambda: w.add_edges(pair, np.full((1, size), np.inf)),
                lambda: w.add_edges(two, np.stack([z, np.full(size, np.nan)]), eye),
                lambda: w.add_edges(two, good, np.stack([eye, -eye])),
                lambda: w.add_edges(two, good, np.stack([eye, np.full_like(eye, np.nan)])),
                lambda: w.add_edges(two, good, np.stack([eye, np.triu(np.ones_like(eye))])),
                lambda: w.add_edges(two, z[None]),
                lambda: w.add_edges(pair, z[None], np.zeros_like(eye)),
            ]
        call = calls[self.random.integers(len(calls))]
        before = w._core.next_edge()
        try:
            call()
        except masat.MasatError:
            assert w._core.next_edge() == before
        else:
            raise AssertionError("an invalid operation was not refused")

    def update(self) -> None:
        """Update with or without a budget, and compare the map with the account."""
        budgets = (None, None, 0.0, 1e-4, 1e-2)
        done = self.world.update(budgets[self.random.integers(len(budgets))])
        assert np.isfinite(done.chi2)
        self.commit()

    def commit(self) -> None:
        """Take what waited into the account, after an update."""
        self.edges |= self.added
        for number in self.removed:
            del self.edges[number]
        self.added, self.removed, self.complete_ids = {}, [], len(self.ids)
        assert len(self.world) == len(self.ids)
        check_poses(self.world.poses)
        if self.random.random() < 0.1:
            self.check_contents()

    def check_contents(self) -> None:
        """Assert that the map holds the nodes and edges of the account."""
        assert self.world.ids.tolist() == self.ids[: self.complete_ids]
        if self.complete_ids:
            graph = self.world.graph()
            pairs = [self.edges[number] for number in sorted(self.edges)]
            assert graph.edges.tolist() == [list(p) for p in pairs if p[1] not in self.points]
            waiting = set(self.world.waiting_observations.tolist())
            held = 0 if graph.landmarks is None else len(graph.landmarks.observations)
            assert held + len(waiting) == sum(pair[1] in self.points for pair in pairs)
            assert waiting <= set(self.edges)

    def update_in_vain(self) -> None:
        """Add what an update cannot solve: what waited is forgotten, and all else is as before."""
        if not self.complete_ids:
            return
        before, covariances = self.world.poses, self.world.covariances()
        node = int(self.random.integers(-(2**62), 2**62))
        z = np.stack([lie.identity(self.dimension)] * 2)
        z[0, 0] = 10.0 ** self.random.integers(100, 300)
        self.world.add_pose(node)
        information = np.eye(self.dof) * 10.0 ** self.random.integers(-300, 300)
        self.world.add_edges([(self.ids[0], node), (node, self.ids[0])], z, information)
        try:
            self.world.update()
        except masat.OptimizationError:
            self.counts["updates that failed"] += 1
        else:
            check_poses(self.world.poses)
            assert np.isfinite(self.world.chi2)
            self.start()  # poses are as far away as the measurement says
            return
        self.ids = self.ids[: self.complete_ids]
        self.added, self.removed = {}, []
        assert np.array_equal(self.world.poses, before), "a failed update moved poses"
        # They are those of another linearization, at the poses.
        now = self.world.covariances()
        check_covariances(now)
        assert (now.any(axis=(1, 2)) == covariances.any(axis=(1, 2))).all()
        self.check_contents()

    def read_covariances(self) -> None:
        """Read covariances in the thread that writes."""
        if self.complete_ids:
            ids = self.random.choice(self.ids[: self.complete_ids], 4)
            check_covariances(self.world.covariances(ids))
            check_covariances(self.world.relative_covariances(ids.reshape(2, 2)))

    def optimize(self) -> None:
        """Take the map to the optimum."""
        if self.ids:
            self.world.optimize()
            self.commit()

    def compare(self) -> None:
        """Compare the map with the batch solver, which begins at its poses."""
        if not self.ids:
            return
        self.world.update()
        self.commit()
        self.check_contents()
        graph = self.world.graph()
        best = masat.optimize(graph, relative_tolerance=1e-13).chi2
        bound = best * (1 + self.max_excess) + NEGLIGIBLE * len(graph.edges)
        assert self.world.chi2 <= bound, f"chi2 {self.world.chi2}, the batch solver's is {best}"

    def save_and_load(self) -> None:
        """Go on with the map that was saved and loaded; what waited is not part of it."""
        path = Path(self.folder.name) / "map.npz"
        self.world.save(path)
        loaded = RecordedMap.load(path)
        assert np.allclose(loaded.poses, self.world.poses, rtol=0, atol=1e-12)
        self.watch(loaded)
        self.ids = self.ids[: self.complete_ids]
        self.added, self.removed = {}, []
        self.check_contents()


def stress(
    dimension: int,
    operations: int,
    seed: int,
    *,
    readers: int = 3,
    most_nodes: int = 150,
    max_excess: float = MAX_EXCESS,
) -> tuple[Counter[str], int]:
    """Do random operations; return how many of each kind, and the number of reads beside them."""
    threads = Readers(readers)
    try:
        writer = Writer(dimension, seed, threads, most_nodes, max_excess)
        for _ in range(operations):
            writer.step()
            if threads.errors:
                break
    finally:
        threads.stop()
    writer.folder.cleanup()
    return writer.counts, threads.reads


def main() -> None:
    """Do random operations in 2D and in 3D, and print how many."""
    parser = argparse.ArgumentParser(description="Random operations on a map that grows.")
    parser.add_argument("--operations", type=int, default=10_000, help="in both dimensions")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--readers", type=int, default=3)
    parser.add_argument("--nodes", type=int, default=150, help="before another map is begun")
    parser.add_argument("--excess", type=float, default=MAX_EXCESS, help="over the batch chi2")
    options = parser.parse_args()
    for dimension in (2, 3):
        begin = perf_counter()
        counts, reads = stress(
            dimension,
            options.operations // 2,
            options.seed,
            readers=options.readers,
            most_nodes=options.nodes,
            max_excess=options.excess,
        )
        print(f"{dimension}D: {perf_counter() - begin:.1f} s, {reads} reads beside the writer")
        for name, count in counts.most_common():
            print(f"    {count:8d} {name}")


if __name__ == "__main__":
    main()
