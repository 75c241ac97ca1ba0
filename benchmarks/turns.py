"""What whole turns around weak loops do for minima of the paper's evaluation.

Run `python -m benchmarks.turns [CELL ...]`, a cell such as City10k/.35,.35,.35; needs the paper's
worlds (MASAT_DATASETS). Takes a minute or two a cell.
"""

from __future__ import annotations

import sys
from time import perf_counter

import numpy as np

import masat
from masat.study.names import Case
from masat.study.trial import guess_of, instance, solve
from masat.windings import unwind

CELLS = ("City10k/.35,.35,.35", "City10k/.15,.15,.3")
INSTANCES = 50
SOON = 15


def above(chi2: float, control: float) -> bool:
    """Tell whether chi2 is that of a higher minimum than the control's."""
    return chi2 > control * (1 + 1e-6)


def measure(cell: str) -> str:
    """Return a line of the table."""
    world, sigmas = cell.split("/")
    sigma = tuple(float(s) for s in sigmas.split(","))
    runs = before = after = 0
    ratios = []
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
        runs += 1
        control = solve(guess_of(graph, "ground_truth"), 50).chi2
        start = perf_counter()
        unwound = unwind(near.graph)
        took = perf_counter() - start
        ratios.append(took / solve(guess_of(graph, "masat"), 50).seconds)
        before += above(masat.optimize(near.graph).chi2, control)
        after += above(masat.optimize(graph.with_poses(unwound.poses)).chi2, control)
    return f"{cell:<32}{runs:>6}{before:>8}{after:>7}{np.median(ratios):>9.2f}"


def main() -> None:
    """Print a table of counts, and of the median time over Gauss-Newton's from MASAT."""
    print("minima that Gauss-Newton soon reaches from the chordal start, and how many of them lie")
    print("above the control's, before and after the turns; their time over GN's from MASAT")
    print(f"{'cell':<32}{'runs':>6}{'before':>8}{'after':>7}{'time':>9}")
    for cell in sys.argv[1:] or CELLS:
        print(measure(cell), flush=True)


if __name__ == "__main__":
    main()
