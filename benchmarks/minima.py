"""What the search for lower minima does, where Gauss-Newton soon converges in the evaluation.

Run `python -m benchmarks.minima [CELL ...]`, a cell such as City10k/.35,.35,.35; needs the paper's
worlds (MASAT_DATASETS). Takes two minutes or so a cell.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from time import perf_counter

import numpy as np

import masat
from masat import PoseGraph
from masat.arrays import Floats
from masat.lifting import lift_weak_places
from masat.minima import lower_minimum
from masat.study.names import Case
from masat.study.trial import guess_of, instance, solve
from masat.windings import unwind

CELLS = ("City10k/.35,.35,.35", "City10k/.15,.15,.3", "Manhattan10000/.25,.25,.25")
INSTANCES = 50
SOON = 15
WAYS: dict[str, Callable[[PoseGraph], Floats | None]] = {
    "none": lambda graph: graph.poses,
    "turns": lambda graph: unwind(graph).poses,
    "lifts": lift_weak_places,
    "both": lambda graph: lower_minimum(graph).graph.poses,
}


def measure(cell: str) -> str:
    """Return a line of the table."""
    world, sigmas = cell.split("/")
    sigma = tuple(float(s) for s in sigmas.split(","))
    above: dict[str, list[bool]] = {way: [] for way in WAYS}
    times: dict[str, list[float]] = {way: [] for way in WAYS}
    for k in range(INSTANCES):
        graph = instance(Case(world, sigma, k))
        near = masat.optimize(
            guess_of(graph, "chordal"),
            "gauss_newton",
            max_iterations=SOON,
            relative_tolerance=1e-4,
        )
        if not near.converged:
            continue
        control = solve(guess_of(graph, "ground_truth"), 50).chi2
        plain = solve(guess_of(graph, "masat"), 50).seconds
        for way, improve in WAYS.items():
            start = perf_counter()
            poses = improve(near.graph)
            times[way].append((perf_counter() - start) / plain)
            assert poses is not None
            best = masat.optimize(graph.with_poses(poses)).chi2
            above[way].append(best > control * (1 + 1e-6))
    counts = "".join(f"{sum(above[way]):>7}" for way in WAYS)
    ratios = "".join(f"{np.median(times[way]):>7.2f}" for way in WAYS if way != "none")
    return f"{cell:<32}{len(above['none']):>5}{counts}{ratios}"


def main() -> None:
    """Print a table of counts, and of the median times over Gauss-Newton's from MASAT."""
    print("minima that Gauss-Newton soon reaches from the chordal start; how many of them lie")
    print("above the control's, as they are and after each search; the searches' times over those")
    print("of Gauss-Newton from MASAT")
    names = "".join(f"{way:>7}" for way in WAYS)
    print(f"{'cell':<32}{'runs':>5}{names}" + "".join(f"{w:>7}" for w in WAYS if w != "none"))
    for cell in sys.argv[1:] or CELLS:
        print(measure(cell), flush=True)


if __name__ == "__main__":
    main()
