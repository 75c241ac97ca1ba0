"""masat's ways from a file to a map."""

from __future__ import annotations

import pathlib
from functools import partial
from itertools import pairwise

import masat
from benchmarks.paths import Clock, Path, Run
from masat.initializers import INITIALIZERS

_OPTIMIZERS = {"GN": "gauss_newton", "LM": "levenberg_marquardt"}


def paths(file: pathlib.Path, threads: int) -> dict[str, Path]:
    """Return each start with each optimizer."""
    return {
        f"{start} + {name}": partial(_run, file, start, optimizer, threads)
        for start in INITIALIZERS
        for name, optimizer in _OPTIMIZERS.items()
    }


def _run(file: pathlib.Path, start: str, optimizer: str, threads: int, iterations: int) -> Run:
    clock = Clock()
    graph = masat.read(file)
    load = clock.lap()
    guess = masat.initialize(graph, start)
    started = clock.lap()
    result = masat.optimize(guess, optimizer, max_iterations=iterations, threads=threads)
    took = clock.lap()
    return Run(load, started, took, [i.chi2 for i in result.history], result.poses)


def iteration(graph: masat.PoseGraph, count: int, threads: int = 1) -> list[float]:
    """Return the times in ms of Gauss-Newton iterations from the poses of a graph."""
    result = masat.optimize(
        graph, "gauss_newton", max_iterations=count, relative_tolerance=0.0, threads=threads
    )
    seconds = [i.seconds for i in result.history]
    return [1e3 * (b - a) for a, b in pairwise(seconds)]
