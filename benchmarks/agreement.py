"""Gauss-Newton of g2o against ours, from MASAT, on the instances of the paper's study.

Run `python -m benchmarks.agreement Manhattan3500 .15,.15,.3 50`; needs the extra `bench`, and
the public graphs (MASAT_DATASETS).
"""

from __future__ import annotations

import sys

import masat
from benchmarks.with_g2o import built
from masat.study import Case, Trial
from masat.study.trial import THRESHOLD, initial_guess, instance, run_inits

_LIMIT = 50


def chi2_of_g2o(graph: masat.PoseGraph) -> tuple[float, ...]:
    """Return chi2 at the poses of a planar graph and after each iteration of g2o."""
    optimizer = built(graph, "GN")
    optimizer.initialize_optimization()
    optimizer.compute_active_errors()
    chi2 = [optimizer.active_chi2()]
    while len(chi2) <= _LIMIT:
        optimizer.optimize(1)
        optimizer.compute_active_errors()
        chi2.append(optimizer.active_chi2())
        if 0 <= chi2[-2] - chi2[-1] < THRESHOLD * chi2[-1]:
            break
    return tuple(chi2)


def main(world: str, sigmas: str, instances: int) -> None:
    """Print on how many instances both succeed, fail, and stop at the same iteration."""
    found = []
    for k in range(instances):
        case = Case(world, tuple(float(s) for s in sigmas.split(",")), k)
        (ours,) = run_inits(case, ("masat",), _LIMIT)
        chi2 = chi2_of_g2o(initial_guess(instance(case), "masat"))
        theirs = Trial(case, "masat", chi2, 1, 0.0, 0.0)
        found.append((ours.success(), theirs.success()))
    print(
        f"{world} ({sigmas}), {instances} instances: ours converges on "
        f"{sum(a is not None for a, _ in found)}, g2o on {sum(b is not None for _, b in found)}; "
        f"the same outcome on {sum((a is None) == (b is None) for a, b in found)}, the same "
        f"iteration on {sum(a == b for a, b in found)}"
    )


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], int(sys.argv[3]))
