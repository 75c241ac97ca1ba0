"""The format of TORO: VERTEX2 and EDGE2, VERTEX and EDGE, VERTEX3 and EDGE3.

Information in 2D is listed as xx xy yy tt xt yt, where t is theta; in 3D it is the upper triangle
in the order x, y, z, roll, pitch, yaw. Source: Grisetti, Stachniss, Burgard, Nonlinear constraint
network optimization for efficient map learning, 2009.
"""

from __future__ import annotations

from masat.formats.table import Format, InformationText, Kind, PoseText, Record

FORMAT = Format(
    name="toro",
    summary="TORO: VERTEX2, EDGE2, VERTEX, EDGE, VERTEX3, EDGE3",
    records=(
        Record("EDGE2", Kind.EDGE, PoseText.XY_THETA, InformationText.TORO_PLANAR),
        Record("VERTEX2", Kind.VERTEX),
        Record("EDGE", Kind.EDGE, PoseText.XY_THETA, InformationText.TORO_PLANAR),
        Record("VERTEX", Kind.VERTEX),
        Record("EDGE3", Kind.EDGE, PoseText.XYZ_RPY),
        Record("VERTEX3", Kind.VERTEX, PoseText.XYZ_RPY),
    ),
)
