"""What a factor that is kept on disk costs, against computing it again.

    python -m benchmarks.factor_on_disk

Factors of simulated worlds as large as parts are. The file is written to the disk itself, and read
after the operating system has been asked to forget it. Needs Linux and 1 GB.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from time import perf_counter

import numpy as np

import masat
from benchmarks.threads import single_threaded
from masat._core import NormalEquations
from masat.arrays import Floats
from masat.optimizers.equations import normal_equations
from masat.worlds import city, perturb, sphere

_ROUNDS = 5


def main() -> None:
    """Print a table."""
    single_threaded()
    print(f"{'world':<16}{'factor MB':>10}{'compute s':>10}{'write s':>10}{'read s':>10}")
    for world, nodes, noise in (
        (city, 60_000, (0.05, 0.05, 0.02)),
        (city, 250_000, (0.05, 0.05, 0.02)),
        (sphere, 10_000, (0.05, 0.02)),
    ):
        graph = masat.initialize(perturb(world(nodes), noise), "masat")
        assert graph.poses is not None
        poses, size = graph.poses, graph.elimination.factor_bytes(graph.dof)
        equations = normal_equations(graph, 1)
        undamped = np.zeros(graph.dof * len(graph.structure.free))
        factor = np.ones(size // 8)
        with tempfile.TemporaryDirectory(dir=".") as folder:
            path = Path(folder) / "factor"
            computing = partial(compute, equations, poses, undamped)
            steps = computing, partial(write, path, factor), partial(read, path)
            times = "".join(f"{least(step):>10.2f}" for step in steps)
        print(f"{world.__name__:<8}{nodes:>8}{size / 1e6:>10.0f}{times}", flush=True)


def compute(equations: NormalEquations, poses: Floats, damping: Floats) -> None:
    """Set up a system and factorize it."""
    equations.linearize(poses)
    assert equations.factorize(damping) < 0


def write(path: Path, factor: Floats) -> None:
    """Write an array to the disk, not only to the cache."""
    with path.open("wb") as file:
        factor.tofile(file)
        file.flush()
        os.fsync(file.fileno())


def read(path: Path) -> None:
    """Read a file from the disk, not from the cache."""
    with path.open("rb") as file:
        os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)
        np.fromfile(file)


def least(step: Callable[[], None]) -> float:
    """Return the least of several times."""
    times = []
    for _ in range(_ROUNDS):
        begin = perf_counter()
        step()
        times.append(perf_counter() - begin)
    return min(times)


if __name__ == "__main__":
    main()
