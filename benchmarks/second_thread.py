"""The parts of an iteration with one thread and with two.

Run `python -m benchmarks.second_thread [GRAPH ...] [--seconds N]`; needs the data (MASAT_DATA).
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from time import perf_counter

import numpy as np

from benchmarks.graphs import CITY, graph_of
from benchmarks.threads import single_threaded
from masat import PoseGraph, _core
from masat.optimizers.equations import normal_equations

# What an iteration with two threads may take at most, in iterations with one.
WANTED = {"sphere2500": 0.75, "city10000": 0.75, "torus3D": 0.6, "sphere_bignoise": 0.6, CITY: 0.6}
REPETITIONS = 4
WHOLE = "iteration"


def parts_of(graph: PoseGraph, equations: _core.NormalEquations) -> dict[str, Callable[[], object]]:
    """Return the parts of an iteration, and the iteration, ready to be called."""
    assert graph.poses is not None
    poses = graph.poses
    equations.linearize(poses)
    undamped = np.zeros_like(equations.rhs())
    assert equations.factorize(undamped) < 0
    step = equations.solve()

    def iteration() -> None:
        equations.linearize(poses)
        equations.factorize(undamped)
        equations.chi2(equations.retract(poses, equations.solve()))

    return {
        "linearize": lambda: equations.linearize(poses),
        "factorize": lambda: equations.factorize(undamped),
        "solve": equations.solve,
        "retract": lambda: equations.retract(poses, step),
        "cost": lambda: equations.chi2(poses),
        WHOLE: iteration,
    }


def measure(graph: PoseGraph, seconds: float) -> dict[str, list[float]]:
    """Return the least time of each part in ms, with one thread and with two.

    Both alternate, so that other work on the machine hits them alike. It can only add to a time,
    and two threads need two free cores: the least time is the one that says something.
    """
    parts = [parts_of(graph, normal_equations(graph, threads)) for threads in (1, 2)]
    least = {name: [np.inf, np.inf] for name in parts[0]}
    end = perf_counter() + seconds
    while perf_counter() < end:
        for name, times in least.items():
            for k, tasks in enumerate(parts):
                for _ in range(REPETITIONS):
                    begin = perf_counter()
                    tasks[name]()
                    times[k] = min(times[k], 1e3 * (perf_counter() - begin))
    return least


def main() -> None:
    """Print a table of times in ms and of their ratios."""
    single_threaded()
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("graphs", nargs="*", default=list(WANTED), metavar="GRAPH")
    parser.add_argument("--seconds", type=float, default=20, help="for each graph")
    arguments = parser.parse_args()
    print("least times in ms of one thread and of two, and their ratio; * misses what is wanted")
    for name in arguments.graphs:
        graph = graph_of(name)
        print(f"{name} ({len(graph.ids)} poses, {len(graph.edges)} edges)", flush=True)
        for part, (one, two) in measure(graph, arguments.seconds).items():
            wanted = WANTED.get(name) if part == WHOLE else None
            print(
                f"    {part:<10}{one:>9.3f}{two:>9.3f}{two / one:>7.2f}"
                + ("" if wanted is None else f"{'*' if two > wanted * one else ' '} of {wanted}"),
                flush=True,
            )


if __name__ == "__main__":
    main()
