"""What the search for lower minima does, from where the chordal start leads in the evaluation.

Run `python -m benchmarks.minima [CELL ...]`, a cell such as City10k/.35,.35,.35; needs the paper's
worlds (MASAT_DATASETS). Takes a minute or two a cell.
"""

from __future__ import annotations

import sys
from time import perf_counter

import numpy as np

import masat
from masat.optimality.search import lower_minimum
from masat.study.names import Case
from masat.study.trial import initial_guess, instance, solve

CELLS = (
    "Manhattan3500/.35,.35,.35",
    "City10k/.35,.35,.35",
    "City10k/.15,.15,.3",
    "Manhattan10000/.25,.25,.25",
)
INSTANCES = 50
SAME = 1e-6


def measure(cell: str) -> str:
    """Return a line of the table."""
    world, sigmas = cell.split("/")
    sigma = tuple(float(s) for s in sigmas.split(","))
    runs, before, after, below = 0, 0, 0, 0
    ratios = []
    for k in range(INSTANCES):
        graph = instance(Case(world, sigma, k))
        control = solve(initial_guess(graph, "ground_truth"), 50)
        if not control.converged:
            continue
        plain = solve(initial_guess(graph, "masat"), 50)
        local = masat.optimize(initial_guess(graph, "chordal"), "dogleg")
        start = perf_counter()
        found = lower_minimum(local.graph)
        if plain.converged:
            ratios.append((perf_counter() - start) / plain.seconds)
        runs += 1
        before += local.chi2 > control.chi2 * (1 + SAME)
        after += found.chi2 > control.chi2 * (1 + SAME)
        below += found.chi2 < control.chi2 * (1 - SAME)
    counts = f"{runs:>6}{before:>8}{after:>8}{below:>8}"
    return f"{cell:<30}{counts}{np.median(ratios):>8.2f} ({len(ratios)})"


def main() -> None:
    """Print a table of counts, and of the median times over Gauss-Newton's from MASAT."""
    print(
        f"of {INSTANCES} instances a cell those where the control converges: how many minima near"
    )
    print(
        "the chordal start lie above its own; after the search, how many above and how many below;"
    )
    print("the search's time over that of Gauss-Newton from MASAT, median of those that converge")
    print(f"{'cell':<30}{'runs':>6}{'before':>8}{'above':>8}{'below':>8}{'time':>8}")
    for cell in sys.argv[1:] or CELLS:
        print(measure(cell), flush=True)


if __name__ == "__main__":
    main()
