"""From the file to the best known map, and a Gauss-Newton iteration: masat, gtsam, g2o-python.

Run `python -m benchmarks.solvers [GRAPH ...]`; needs the extra `bench`, and the data (MASAT_DATA).
"""

from __future__ import annotations

import statistics
import sys
import tempfile
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path as File

import numpy as np

import masat
from benchmarks import with_g2o, with_gtsam, with_masat
from benchmarks.graphs import CASES, Case, quietly_read
from benchmarks.paths import LIMIT, Path, Run
from benchmarks.threads import single_threaded
from masat.residuals import chi2_per_edge

WHOLE = 1 / 3
ITERATION = {"gtsam": 0.33, "g2o": 0.5}
_ROUNDS = 5
# Slower paths, in ms, are run once more, not five times.
_SLOW = 2000.0
# How many paths of a solver are timed: those that were fastest when tried.
_RIVALS = 2


@dataclass(frozen=True)
class Tried:
    """A path's first run: whether it leads to the best map, and after how many iterations."""

    path: Path
    chi2: float
    iterations: int | None
    estimate: float
    """Its ms up to that iteration, without reading, which is the same for all of a solver."""


@dataclass(frozen=True)
class Best:
    """The fastest path of a solver that leads to the best map; times are medians in ms."""

    name: str
    iterations: int
    load: float
    start: float
    optimize: float
    chi2: float

    @property
    def total(self) -> float:
        """From the file to the map."""
        return self.load + self.start + self.optimize

    @property
    def loaded(self) -> float:
        """From the graph in memory to the map."""
        return self.start + self.optimize


def chi2_of(graph: masat.PoseGraph, poses: masat.arrays.Floats) -> float:
    """Evaluate anybody's poses; infinite where they are not numbers."""
    if not np.isfinite(poses).all():
        return float("inf")
    return float(chi2_per_edge(graph.with_poses(poses)).sum())


def try_path(case: Case, graph: masat.PoseGraph, path: Path, own: bool) -> Tried | str:
    """Run a path to its end; a refusal is a sentence.

    `own` tells that the solver minimizes an objective of its own: it has arrived where its
    objective is within 1e-6 of its minimum, if from there Gauss-Newton leads to the best map.
    """
    try:
        run = path(LIMIT)
    except (RuntimeError, IndexError, masat.MasatError) as error:
        return f"fails: {str(error).strip().splitlines()[0]}"
    chi2 = chi2_of(graph, run.poses)
    if not np.isfinite(chi2) or not run.history:
        return "breaks down"
    target = case.best
    if own:
        polished = masat.optimize(
            graph.with_poses(run.poses), "gauss_newton", max_iterations=20
        ).chi2
        target = min(run.history) if case.reached(polished) else 0.0
    arrived = [k for k, value in enumerate(run.history, 1) if value <= target * (1 + 1e-6)]
    if not arrived:
        return Tried(path, chi2, None, float("inf"))
    estimate = run.start + run.optimize * arrived[0] / len(run.history)
    return Tried(path, chi2, arrived[0], estimate)


def best_of(
    case: Case, graph: masat.PoseGraph, paths: Mapping[str, Path], own: bool = False
) -> tuple[Best | None, list[str]]:
    """Return the fastest of the paths that arrive, and a line for each that does not."""
    arrived: dict[str, Tried] = {}
    failures = []
    for name, path in paths.items():
        tried = try_path(case, graph, path, own)
        if isinstance(tried, str):
            failures.append(f"{name} {tried}")
        elif tried.iterations is None:
            failures.append(f"{name} ends at {tried.chi2:.7g}")
        else:
            arrived[name] = tried
    if not arrived:
        return None, failures
    rivals = sorted(arrived, key=lambda name: arrived[name].estimate)[:_RIVALS]
    fastest = arrived[rivals[0]].estimate
    runs: dict[str, list[Run]] = {name: [] for name in rivals}
    for _ in range(_ROUNDS if fastest < _SLOW else 1):
        for name in rivals:
            # A path that differs from run to run may need another iteration.
            for more in range(3):
                run = arrived[name].path((arrived[name].iterations or 0) + more)
                if own or case.reached(chi2_of(graph, run.poses)):
                    break
            runs[name].append(run)
    found = [summary(name, runs[name], chi2_of(graph, runs[name][-1].poses)) for name in rivals]
    return min(found, key=lambda best: best.loaded), failures


def summary(name: str, runs: Sequence[Run], chi2: float) -> Best:
    """Return the medians of the runs of a path."""
    parts = zip(*((run.load, run.start, run.optimize) for run in runs), strict=True)
    load, start, optimize = (statistics.median(part) for part in parts)
    return Best(name, len(runs[-1].history), load, start, optimize, chi2)


def solvers(
    case: Case, file: File, graph: masat.PoseGraph, folder: File
) -> dict[str, Callable[[], tuple[Best | None, list[str]]]]:
    """Return the rows of a graph's table."""
    ours = {"masat": 1} if graph.dimension == 2 else {"masat": 1, "masat, 2 threads": 2}
    best = partial(best_of, case, graph)
    rows: dict[str, Callable[[], tuple[Best | None, list[str]]]] = {
        name: partial(best, with_masat.paths(file, threads)) for name, threads in ours.items()
    }
    rows["gtsam"] = partial(best, with_gtsam.paths(file, graph, folder), True)
    rows["g2o"] = partial(best, with_g2o.paths(file))
    guess = masat.initialize(graph, "masat")
    rows["g2o from MASAT"] = partial(best, {"GN": with_g2o.path_from(guess)})
    return rows


def whole(case: Case, folder: File) -> None:
    """Print the rows of a graph."""
    file = case.plain(folder)
    graph = quietly_read(file)
    found = {name: measure() for name, measure in solvers(case, file, graph, folder).items()}
    reference = found["masat" if graph.dimension == 2 else "masat, 2 threads"][0]
    for name, (best, failures) in found.items():
        label = case.name if name == "masat" else ""
        if best is not None:
            line = (
                f"{label:<16}{name:<17}{best.name:<20}{best.iterations:>4}{best.load:>9.1f}"
                f"{best.start:>9.1f}{best.optimize:>9.1f}{best.total:>9.1f}"
            )
            if reference is not None and not name.startswith("masat"):
                line += (
                    f"{reference.total / best.total:>7.3f}{reference.loaded / best.loaded:>8.3f}"
                )
            else:
                line += " " * 15
            print(f"{line}{best.chi2:>15.8g}", flush=True)
        # Ours are many: what does not arrive is of interest only if nothing does.
        if failures and (best is None or not name.startswith("masat")):
            for failure in failures:
                print(f"{label if best is None else '':<16}{name:<17}{failure}", flush=True)


def iterations(case: Case, folder: File, count: int = 6) -> dict[str, float]:
    """Return the median ms of a Gauss-Newton iteration, all from MASAT's poses."""
    guess = masat.initialize(quietly_read(case.plain(folder)), "masat")
    file = folder / "guess.g2o"
    masat.write(guess, file)
    tasks: dict[str, Callable[[], list[float]]] = {
        "masat": partial(with_masat.iteration, guess, count),
        "two": partial(with_masat.iteration, guess, count, 2),
        "gtsam": partial(with_gtsam.iteration, file, guess.dimension, count),
        "g2o": partial(with_g2o.iteration, guess, count),
    }
    times: dict[str, list[float]] = {name: [] for name in tasks}
    for _ in range(3):
        for name, task in tasks.items():
            times[name] += task()
    return {name: statistics.median(values) for name, values in times.items()}


def main() -> None:
    """Print both tables."""
    single_threaded()
    warnings.simplefilter("ignore", masat.MasatWarning)  # starts that bridge gaps say so
    cases = [CASES[name] for name in sys.argv[1:] or CASES]
    with tempfile.TemporaryDirectory() as folder:
        print("file to best known map (chi2 within 1e-6), medians in ms; ratio of masat's time to")
        print(
            f"theirs, wanted at most {WHOLE:.2f} (two threads in 3D); `loaded` leaves reading out"
        )
        print(
            f"{'graph':<16}{'solver':<17}{'path':<20}{'its':>4}{'load':>9}{'start':>9}{'optimize':>9}"
            f"{'total':>9}{'ratio':>7}{'loaded':>8}{'chi2':>15}"
        )
        for case in cases:
            whole(case, File(folder))
        print(
            "\na Gauss-Newton iteration from MASAT's poses, medians in ms; ratios, wanted at most"
        )
        print(f"{ITERATION['gtsam']} of gtsam's and {ITERATION['g2o']} of g2o's, one thread")
        print(
            f"{'graph':<16}{'masat':>8}{'2 thr.':>8}{'gtsam':>9}{'ratio':>8}{'g2o':>9}{'ratio':>8}"
        )
        for case in cases:
            took = iterations(case, File(folder))
            print(
                f"{case.name:<16}{took['masat']:>8.2f}{took['two']:>8.2f}{took['gtsam']:>9.2f}"
                f"{took['masat'] / took['gtsam']:>8.3f}{took['g2o']:>9.2f}"
                f"{took['masat'] / took['g2o']:>8.3f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
