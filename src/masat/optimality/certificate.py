"""Whether a solution is the global optimum."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from masat.arrays import Floats
from masat.errors import OptimizationError
from masat.graph import PoseGraph
from masat.optimality import relaxation
from masat.optimality.search import lower_minimum
from masat.optimizers import optimize

# chi2 this much lower, relatively, is another minimum; as between two solvers.
_SAME = 1e-6


@dataclass(frozen=True)
class Certificate:
    """What is known about how good the poses of a graph are.

    Attributes
    ----------
    certified : bool
        Whether the poses are proven to be globally optimal, in the sense of `message`.
    message : str
        What was found, in a sentence.
    chi2, optimum : float
        chi2 of the poses, and the lowest that an optimizer reached from them or from the minimum
        of the chordal cost.
    cost, bound : float
        Chordal cost of that minimum, and a number that no poses' chordal cost lies below.
    exact : bool
        Whether the chordal cost is chi2 itself: in 3D, with isotropic information.
    better : PoseGraph or None
        The graph at poses of lower chi2, if such were found.
    """

    certified: bool
    message: str
    chi2: float
    optimum: float
    cost: float
    bound: float
    exact: bool
    better: PoseGraph | None

    @property
    def gap(self) -> float:
        """How far, as a share of the cost, the bound lies below it."""
        return (self.cost - self.bound) / self.cost if self.cost > self.bound else 0.0


def certify(graph: PoseGraph, *, lift: bool = True, seed: int = 0, threads: int = 1) -> Certificate:
    """Tell whether the poses of a graph, from whatever program, are globally optimal.

    The proof is of the chordal cost (see `masat.optimality.relaxation`): its minimum near the poses is global
    if the matrix of its Lagrangian is positive semidefinite, which one factorization shows, and
    the higher ranks tighten the bound. The poses share that proof if an optimizer leads from it to
    the same chi2 and from them no lower.

    Parameters
    ----------
    graph : PoseGraph
        A graph with the poses in question.
    lift : bool
        Whether to go to higher ranks where the poses' own leaves a gap, and to look there for a
        lower minimum (`masat.optimality.search`): dear.
    seed : int
        Of the noise that opens higher ranks.
    threads : int
        Of the optimizer.

    Returns
    -------
    Certificate

    Raises
    ------
    OptimizationError
        If the graph has no poses.
    """
    if graph.poses is None:
        raise OptimizationError("the graph has no poses: there is nothing to certify")
    own = optimize(graph, threads=threads)
    assert own.graph.poses is not None
    solution = relaxation.solve(own.graph, own.graph.poses, lift=lift, seed=seed)
    other = optimize(graph.with_poses(solution.poses), threads=threads)
    best = min(own, other, key=lambda result: result.chi2)
    if lift and not solution.certified:
        best = min(best, lower_minimum(best.graph, seed=seed), key=lambda result: result.chi2)
    same = _SAME * best.chi2 + solution.nothing
    lower = own.initial_chi2 - best.chi2 > same
    certified = solution.certified and not lower and other.chi2 - best.chi2 <= same
    exact = _exact(graph)
    if lower:
        found = "the same minimum" if own.chi2 - best.chi2 <= same else "another minimum"
        message = (
            f"not optimal: {found} has chi2 {best.chi2:.8g}, lower than {own.initial_chi2:.8g}"
        )
    elif not certified:
        message = "not decided: no lower minimum was found, and no proof that there is none"
    elif exact:
        message = "globally optimal: no poses have a chi2 that is lower by more than the gap"
    else:
        message = (
            "globally optimal for the chordal cost, which stands for chi2: no poses have a cost "
            "that is lower by more than the gap, and the optimizers lead from there to these poses"
        )
    return Certificate(
        certified=certified,
        message=message,
        chi2=own.initial_chi2,
        optimum=best.chi2,
        cost=solution.cost,
        bound=solution.bound,
        exact=exact,
        better=best.graph if lower else None,
    )


def _exact(graph: PoseGraph) -> bool:
    """Whether the chordal cost is chi2 itself."""
    if graph.dimension == 2:
        return False

    def isotropic(blocks: Floats) -> bool:
        return bool(np.allclose(blocks, blocks[:, :1, :1] * np.eye(3), rtol=1e-9, atol=0))

    w = graph.information
    return isotropic(w[:, :3, :3]) and isotropic(w[:, 3:, 3:]) and not w[:, :3, 3:].any()
