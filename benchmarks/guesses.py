"""What the initial guesses cost: beside a Gauss-Newton iteration, beside MASAT, beside SE-Sync.

Run `python -m benchmarks.guesses [GRAPH ...]`; needs the extra `bench`, and the data (MASAT_DATA).
"""

from __future__ import annotations

import sys
import tempfile
from functools import partial
from pathlib import Path

import masat
from benchmarks.data import medians
from benchmarks.graphs import CASES, Case, quietly_read, unused
from benchmarks.solvers import iterations
from benchmarks.threads import single_threaded

# Times in ms of the C++ SE-Sync, and of a Gauss-Newton iteration of the C++ g2o with CHOLMOD beside
# it, once, on a machine with two cores. ais2klinik took longer.
SE_SYNC = {
    "M3500": (2854, 8.3),
    "city10000": (3712, 30),
    "10kHog-man": (25949, 35),
    "ais2klinik": (40000, 12),
    "kitti_00": (8722, 3.4),
    "intel": (426, 1.7),
    "sphere2500": (974, 28),
    "torus3D": (2090, 63),
    "parking-garage": (4736, 13),
    "sphere_bignoise": (1418, 40),
}
CHORDAL = {2: 1.0, 3: 3.0}
LIFTED = {2: 1 / 5, 3: 1 / 3}


def fresh(graph: masat.PoseGraph, method: str) -> masat.PoseGraph:
    """Initialize a copy for which nothing has been built yet."""
    return masat.initialize(unused(graph), method)


def iterate(graph: masat.PoseGraph) -> masat.Result:
    """Run one Gauss-Newton iteration, with the analysis that it needs."""
    return masat.optimize(unused(graph), "gauss_newton", max_iterations=1)


def optimized(case: Case, graph: masat.PoseGraph, method: str) -> None:
    """Go from the graph to its best map."""
    result = masat.optimize(fresh(graph, method), "gauss_newton", relative_tolerance=1e-6)
    if not case.reached(result.chi2):
        raise SystemExit(f"{method} on {case.name} ends at {result.chi2}")


def measure(case: Case) -> str:
    """Return a line of the table."""
    graph = quietly_read(case.source)
    took = medians(
        {
            "iteration": partial(iterate, masat.initialize(unused(graph), "masat")),
            "masat": partial(masat.initialize, graph, "masat"),
            "most_informed_first": partial(masat.initialize, graph, "most_informed_first"),
            "chordal": partial(fresh, graph, "chordal"),
            "auto": partial(optimized, case, graph, "auto"),
            "lifted": partial(optimized, case, graph, "lifted"),
        },
        rounds=3,
    )
    line = (
        f"{case.name:<16}{took['masat']:>8.2f}{took['most_informed_first'] / took['masat']:>8.2f}"
        f"{took['iteration']:>8.1f}{took['chordal']:>9.1f}"
        f"{took['chordal'] / took['iteration']:>7.2f} ({CHORDAL[graph.dimension]:.0f})"
        f"{took['auto']:>8.1f}{took['lifted']:>8.1f}"
    )
    if case.name not in SE_SYNC:
        return line
    with tempfile.TemporaryDirectory() as folder:
        scale = iterations(case, Path(folder))["g2o"] / SE_SYNC[case.name][1]
    theirs = SE_SYNC[case.name][0]
    return (
        f"{line}{theirs:>9}{took['lifted'] / theirs:>8.3f}{scale:>7.2f}"
        f"{took['lifted'] / (theirs * min(scale, 1.0)):>8.3f} ({LIFTED[graph.dimension]:.2f})"
    )


def main() -> None:
    """Print a table of medians and ratios."""
    single_threaded()
    print("medians in ms, wanted ratios in brackets; MASAT, and most_informed_first over it (2);")
    print("a first Gauss-Newton iteration, the chordal guess, and its ratio to that; graph to best")
    print(
        "map by auto and by lifted; SE-Sync's recorded time; lifted's ratio to that, g2o-python's"
    )
    print("iteration here over g2o's recorded one, and lifted's ratio to the lesser of both times")
    print(
        f"{'graph':<16}{'masat':>8}{'by info':>8}{'GN':>8}{'chordal':>9}{'ratio':>11}"
        f"{'auto':>8}{'lifted':>8}{'SE-Sync':>9}{'ratio':>8}{'scale':>7}{'ratio':>15}"
    )
    for name in sys.argv[1:] or CASES:
        print(measure(CASES[name]), flush=True)


if __name__ == "__main__":
    main()
