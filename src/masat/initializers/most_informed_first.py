"""MASAT in the order of what is known of the nodes."""

from __future__ import annotations

from masat import _core
from masat.graph import PoseGraph
from masat.initializers.roots import gauge_poses


def most_informed_first(graph: PoseGraph) -> PoseGraph:
    """Place each node as MASAT does, but next the one that its placed neighbors know best.

    A measurement has the variance 1, and a proposal that plus the variance v of who makes it. A
    node that waits has gathered the sum of 1 / (v + 1) as information; the one with most comes
    next, and its variance is 1 / that. The map thus closes its loops before it follows single
    measurements. Positions and rotations are averaged as in MASAT; information matrices play no
    part.

    On 432 instances of the paper's worlds Gauss-Newton succeeded in .86, from MASAT in .79: in .94
    and .78 on Manhattan3500, while City10k and Manhattan10000 showed no difference. Positions far
    from the root can lie further off. One pass over the edges, linear time: nodes wait in classes
    of like information. Takes 1.3 to 2 times as long as MASAT.

    Notes
    -----
    MASAT is by Hars; the order is that of Prim (Shortest connection networks and some
    generalizations, 1957), with what all placed neighbors say in place of the best edge.
    Proposals are taken to be independent, though they share errors: with variances that allow for
    that, the walk is nearly breadth-first again, and the guesses no better than those of MASAT.
    """
    roots, poses, notes = gauge_poses(graph)
    placed = _core.place_most_informed_first(graph.topology, roots, graph.measurements, poses)
    return graph.with_poses(placed, notes=notes)
