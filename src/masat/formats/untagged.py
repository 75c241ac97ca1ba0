"""Tables without tags, as ground truth is often published: poses in 2D, or edges in 2D."""

from __future__ import annotations

from masat.formats.table import Format, InformationText, Kind, PoseText, Record

TRAJECTORY = Format(
    name="trajectory",
    summary="lines of x y theta: poses, numbered from 0",
    records=(Record("", Kind.POSE),),
    columns=(3,),
)

EDGE_LIST = Format(
    name="edges",
    summary="lines of from to x y theta and the 3x3 covariance matrix, row by row",
    records=(Record("", Kind.EDGE, PoseText.XY_THETA, InformationText.COVARIANCE),),
    columns=(14,),
)
