"""The format of g2o: VERTEX_SE2, EDGE_SE2, VERTEX_SE3:QUAT, EDGE_SE3:QUAT, FIX.

Information is the upper triangle, row by row, in the order of the residual: x, y, theta in 2D, the
translation and the vector part of the quaternion in 3D. Source: Kuemmerle et al., g2o: a general
framework for graph optimization, ICRA 2011.
"""

from __future__ import annotations

import numpy as np

from masat._core import format_lines
from masat.errors import GraphError
from masat.formats.labels import label_texts
from masat.formats.stamps import stamp_texts
from masat.formats.table import Format, Kind, PoseText, Record
from masat.graph import PoseGraph

_TAGS = {2: ("VERTEX_SE2", "EDGE_SE2"), 3: ("VERTEX_SE3:QUAT", "EDGE_SE3:QUAT")}


def format_graph(graph: PoseGraph) -> bytes:
    """Return the graph as g2o text, whose numbers read back as the same doubles."""
    if graph.poses is None and len(graph.edges) == 0:
        raise GraphError("a graph with neither poses nor edges cannot be written")
    if graph.poses is None and graph.stamps is not None:
        raise GraphError(
            "the stamps cannot be written, since a graph without poses has no lines of vertices: "
            "give it poses with masat.initialize, or remove the stamps with `with_stamps(None)`"
        )
    labels = getattr(graph, "labels", None)
    vertex, edge = _TAGS[graph.dimension]
    upper = np.triu_indices(graph.dof)
    values = np.hstack([graph.measurements, graph.information[:, upper[0], upper[1]]])
    if graph.poses is not None:
        stamps = [] if graph.stamps is None else stamp_texts(graph.stamps)
        vertices = format_lines(vertex, graph.ids[:, None], graph.poses, stamps, "stamp")
        fixed = graph.fixed
    else:
        # A node with neither pose nor edge has no line that FIX could refer to.
        vertices, fixed = b"", graph.fixed[np.isin(graph.fixed, graph.edges)]
    return (
        vertices
        + format_lines("FIX", fixed[:, None], np.empty((len(fixed), 0)))
        + format_lines(
            edge,
            graph.edges,
            np.ascontiguousarray(values),
            [] if labels is None else label_texts(labels),
        )
    )


FORMAT = Format(
    name="g2o",
    summary="g2o: VERTEX_SE2, EDGE_SE2, VERTEX_SE3:QUAT, EDGE_SE3:QUAT, FIX",
    records=(
        Record("EDGE_SE2", Kind.EDGE),
        Record("VERTEX_SE2", Kind.VERTEX),
        Record("EDGE_SE3:QUAT", Kind.EDGE, PoseText.XYZ_QUATERNION, information_optional=True),
        Record("VERTEX_SE3:QUAT", Kind.VERTEX, PoseText.XYZ_QUATERNION),
        Record("FIX", Kind.FIX),
    ),
    format_graph=format_graph,
    suffixes=(".g2o", ".txt", ""),
)
