"""Tree-based network optimizer (TORO)."""

from __future__ import annotations

from masat import _core
from masat.errors import InitializationError
from masat.graph import PoseGraph
from masat.initializers.roots import gauge_poses


def toro(graph: PoseGraph, *, sweeps: int = 10) -> PoseGraph:
    """Improve the breadth-first tree by sweeps of gradient descent over its links.

    Each edge in turn spreads its error over the path through the tree between its two nodes:
    first the rotation, by fractions of one angle about one axis, then the translation. A node
    takes more, the less the information of the edges whose paths hold it. The k-th sweep goes
    1/k of the preconditioned gradient, and no edge beyond its own measurement.

    Parameters
    ----------
    graph : PoseGraph
        The graph.
    sweeps : int
        A sweep costs the sum of the lengths of those paths. On the median of 28 public graphs ten
        leave a hundredth of the chi2 of the tree. Three leave more and thirty less, but after all
        of them Gauss-Newton needs as many iterations there; on sphere2500 with 0.1 m and 0.1 rad
        of noise three cost it one more, thirty at most one less.

    Returns
    -------
    PoseGraph
        The graph with poses.

    Raises
    ------
    InitializationError
        If the number of sweeps is negative.

    Notes
    -----
    Sources: Grisetti, Stachniss, Grzonka and Burgard, A Tree Parameterization for Efficiently
    Computing Maximum Likelihood Maps using Gradient Descent, RSS 2007; Grisetti, Stachniss and
    Burgard, Nonlinear Constraint Network Optimization for Efficient Map Learning, T-ITS 2009.
    As there, edges whose paths reach highest in the tree come first, and an information matrix
    counts as two numbers, for rotation and for translation: here the means of its diagonal. The
    step differs from the authors' program, which goes by the length of the path and by the least
    information in the graph: here it is the information of the edge times the preconditioner,
    summed over the path, so that one weak edge does not change the steps of all others.
    """
    if sweeps < 0:
        raise InitializationError(f"the number of sweeps must not be negative, got {sweeps}")
    roots, poses, notes = gauge_poses(graph)
    placed = _core.place_by_toro(
        graph.topology, roots, graph.measurements, graph.information, poses, sweeps
    )
    return graph.with_poses(placed, notes=notes)
