"""The trajectories of the TUM RGB-D benchmark: lines of stamp x y z qx qy qz qw.

Stamps are in seconds. Source: Sturm, Engelhard, Endres, Burgard, Cremers, A benchmark for the
evaluation of RGB-D SLAM systems, IROS 2012.
"""

from __future__ import annotations

import numpy as np

from masat import lie
from masat._core import format_lines
from masat.errors import GraphError
from masat.formats.stamps import seconds_texts
from masat.formats.table import Format, Kind, PoseText, Record
from masat.graph import PoseGraph


def format_graph(graph: PoseGraph) -> bytes:
    """Return the poses of a graph as the text of a trajectory, in the order of the stamps."""
    assert graph.poses is not None
    assert graph.stamps is not None
    order = np.argsort(graph.stamps, kind="stable")
    stamps = graph.stamps[order]
    for k in np.flatnonzero(stamps[1:] == stamps[:-1])[:1]:
        a, b = graph.ids[order[k : k + 2]]
        raise GraphError(
            f"the nodes {a} and {b} both have the stamp {stamps[k]}, but a TUM trajectory has one "
            "pose at a time: write a file for each robot or session, using `without_nodes`"
        )
    poses = np.ascontiguousarray(lie.to_3d(graph.poses[order]))
    lines = format_lines("", np.empty((len(order), 0), np.int64), poses).splitlines()
    texts = seconds_texts(stamps)
    return b"".join(
        b"%s %s\n" % (text.encode(), line) for text, line in zip(texts, lines, strict=True)
    )


FORMAT = Format(
    name="tum",
    summary="TUM: lines of stamp x y z qx qy qz qw; stamps in seconds",
    records=(Record("", Kind.STAMPED_POSE, PoseText.XYZ_QUATERNION),),
    columns=(8,),
    format_graph=format_graph,
    suffixes=(".tum",),
    needs=("poses", "stamps"),
)
