"""Which loop closures a robust solve keeps, against the truth.

Run `python -m benchmarks.robust [GRAPH KIND FRACTION SEEDS]`, such as `2d/CSAIL.g2o alias 0.5 10`;
without arguments it takes the labeled KITTI graphs. Needs the public graphs (MASAT_DATA).
"""

from __future__ import annotations

import sys
import warnings
from time import perf_counter

import numpy as np

import masat
from benchmarks.data import DATA
from benchmarks.false_closures import labeled, labeled_names
from masat import PoseGraph
from masat.arrays import Flags
from masat.residuals import chi2_per_edge
from masat.worlds.false_closures import add_false_closures, normalized


def measure(name: str, graph: PoseGraph, is_true: Flags) -> str:
    """Return a line of the table."""
    start = perf_counter()
    result = masat.solve(graph, robust=True)
    took = perf_counter() - start
    kept, closures = result.kept, result.closures
    assert kept is not None
    assert closures is not None
    own = closures["edge"]
    true = graph.without_edges(~is_true)
    start = perf_counter()
    best = masat.solve(true)
    plain = perf_counter() - start
    # chi2 over the true edges, of the map and of their own optimum.
    ratio = chi2_per_edge(true, result.poses).sum() / max(best.chi2, 1e-300)
    return (
        f"{name:<40}{np.count_nonzero(is_true[own]):7}{np.count_nonzero(~is_true[own]):7}"
        f"{np.count_nonzero(kept[own] & is_true[own]):7}"
        f"{np.count_nonzero(kept[own] & ~is_true[own]):7}{ratio:9.3f}{took:8.2f}{took / plain:8.0f}"
    )


def main() -> None:
    warnings.simplefilter("ignore", masat.MasatWarning)
    print(
        f"{'':<40}{'true':>7}{'false':>7}{'kept:':>7}{'false':>7}{'strict':>9}{'s':>8}{'plain':>8}"
    )
    print("(strict: chi2 of the true edges over its optimum; plain: time over the solve of these)")
    if len(sys.argv) == 1:
        for name in labeled_names():
            print(measure(name, *labeled(name)), flush=True)
        return
    file, kind, fraction, seeds = sys.argv[1:]
    graph = masat.read(DATA / file, indefinite="identity")
    clean = normalized(masat.solve(graph).graph)
    for seed in range(int(seeds)):
        spoiled, is_false = add_false_closures(clean, kind, float(fraction), seed=seed)
        bare = PoseGraph.from_arrays(spoiled.edges, spoiled.measurements, spoiled.information)
        print(measure(f"{file} {kind} {fraction} {seed}", bare, ~is_false), flush=True)


if __name__ == "__main__":
    main()
