"""How many minima of the paper's evaluation are proven, and what the proofs cost.

    python -m benchmarks.bounds [CELL ..] [--instances N]

A cell is a world and its noise, such as Manhattan3500/.25,.25,.25; the paper's worlds are needed
(MASAT_DATASETS). Each instance is solved from `auto`. A row tells how many of the minima one
factorization proves, how many more the minimum of the relaxation at a higher rank, and how many
more the boxes of relative rotations (`masat.optimality.branching`); the medians of the times of
the solve and of these; and, where one factorization is not enough, how far the bound of the higher
rank lies below chi2, in units of chi2.
"""

from __future__ import annotations

import argparse
import warnings
from time import perf_counter

import numpy as np

import masat
from benchmarks.threads import single_threaded
from masat.optimality.bounds import TIGHT, chi2_bound, lifted_bound
from masat.optimality.branching import branched_bound
from masat.study.names import Case
from masat.study.trial import instance

_WORLDS = ("Manhattan3500", "City10k", "Manhattan10000")
_CELLS = [f"{world}/{s},{s},{s}" for world in _WORLDS for s in (".2", ".25", ".3")]


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("cells", nargs="*", default=_CELLS)
    parser.add_argument("--instances", type=int, default=20)
    options = parser.parse_args()
    single_threaded()
    warnings.simplefilter("ignore")
    print(
        f"{'cell':<28}{'minima':>7}{'at once':>8}{'lifted':>7}{'boxes':>6}"
        f"{'solve s':>9}{'lift s':>8}{'boxes s':>8}{'gap':>7}"
    )
    for cell in options.cells:
        print(row(cell, options.instances), flush=True)


def row(cell: str, instances: int) -> str:
    """Return a line of the table."""
    world, sigma = cell.split("/")
    counts = {"at once": 0, "lifted": 0, "boxes": 0}
    times: dict[str, list[float]] = {"solve": [], "lift": [], "boxes": []}
    gaps = []
    for seed in range(instances):
        graph = instance(Case(world, tuple(map(float, sigma.split(","))), seed))
        begin = perf_counter()
        solved = masat.solve(graph)
        times["solve"].append(perf_counter() - begin)
        best = masat.optimize(solved.graph, relative_tolerance=1e-12)
        enough = best.chi2 * (1 - TIGHT / 2)
        if chi2_bound(best.graph, best.chi2) >= enough:
            counts["at once"] += 1
            continue
        begin = perf_counter()
        bound, _ = lifted_bound(best.graph, best.chi2)
        times["lift"].append(perf_counter() - begin)
        gaps.append(best.chi2 - bound)
        if bound >= enough:
            counts["lifted"] += 1
            continue
        begin = perf_counter()
        bound, lower = branched_bound(best.graph, best.chi2)
        times["boxes"].append(perf_counter() - begin)
        counts["boxes"] += bound >= enough
        if lower is not None:
            print(f"{cell} {seed}: {lower.chi2} is lower than {best.chi2}")
    medians = [float(np.median(own)) if own else np.nan for own in times.values()]
    return (
        f"{cell:<28}{instances:>7}{counts['at once']:>8}{counts['lifted']:>7}{counts['boxes']:>6}"
        f"{medians[0]:>9.2f}{medians[1]:>8.2f}{medians[2]:>8.2f}"
        f"{float(np.median(gaps)) if gaps else 0.0:>7.1f}"
    )


if __name__ == "__main__":
    main()
