"""From a minimum of chi2 to lower ones."""

from __future__ import annotations

from masat.graph import PoseGraph
from masat.lifting import lift_weak_places
from masat.optimizers import Result, optimize
from masat.windings import unwind

# chi2 this much lower, relatively, is another minimum; as between two solvers.
_LOWER = 1e-6
_ROUNDS = 10
_VERY_LAST = 200


def lower_minimum(graph: PoseGraph, *, seed: int = 0) -> Result:
    """Search for a lower minimum around the places that leave doubt about one.

    Where the certificate fails, the poses are lifted (`masat.lifting`) as long as that lowers chi2;
    then another turn is tried around the weak loops (`masat.windings`), and after such turns all
    begins anew.

    Parameters
    ----------
    graph : PoseGraph
        A graph with poses near a minimum.
    seed : int
        Of the noise that opens a higher rank.

    Returns
    -------
    Result
        Of the optimiser, at the lowest minimum met.
    """
    best = _minimum(graph)
    for _ in range(_ROUNDS):
        lifted = _minimum(graph.with_poses(lift_weak_places(best.graph, seed=seed)))
        if lifted.chi2 < best.chi2 * (1 - _LOWER):
            best = lifted
            continue
        unwound = unwind(best.graph)
        if unwound.turns == 0:
            break
        best = _minimum(graph.with_poses(unwound.poses))
    # Gauss-Newton may leave even the surroundings of a minimum, but not the minimum.
    return optimize(best.graph, relative_tolerance=0.0, max_iterations=_VERY_LAST)


def _minimum(graph: PoseGraph) -> Result:
    return optimize(graph, relative_tolerance=1e-8)
