"""The format of iSAM: ODOMETRY, EDGE2, EDGE3, with the square root of the information.

The square root is the upper triangular matrix R whose product R'R is the information. It is listed
row by row in the order of the measurement: x, y, theta, or x, y, z, roll, pitch, yaw. There are no
vertices. Source: Kaess, Ranganathan, Dellaert, iSAM: incremental smoothing and mapping, 2008.
"""

from __future__ import annotations

from masat.formats.table import Format, InformationText, Kind, PoseText, Record

_ROOT = InformationText.SQUARE_ROOT

FORMAT = Format(
    name="isam",
    summary="iSAM: ODOMETRY, EDGE2, EDGE3, square-root information",
    records=(
        Record("EDGE2", Kind.EDGE, PoseText.XY_THETA, _ROOT),
        Record("ODOMETRY", Kind.EDGE, PoseText.XY_THETA, _ROOT),
        Record("EDGE3", Kind.EDGE, PoseText.XYZ_RPY, _ROOT),
    ),
)
