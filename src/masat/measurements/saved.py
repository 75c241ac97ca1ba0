"""The arrays of priors and landmarks, as saved results hold them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import TYPE_CHECKING

from masat.arrays import AnyArray
from masat.measurements.landmarks import Landmarks, landmarks
from masat.measurements.priors import Priors, pose_priors

if TYPE_CHECKING:
    from masat.graph import PoseGraph


def arrays_of(graph: PoseGraph) -> dict[str, AnyArray]:
    """Return the arrays of priors and landmarks, as saved results hold them."""
    out: dict[str, AnyArray] = {}
    for prefix, table in (("priors", graph.priors), ("landmarks", graph.landmarks)):
        if table is not None:
            for field in fields(table):
                value = getattr(table, field.name)
                if value is not None:
                    out[f"{prefix}_{field.name}"] = value
    return out


def saved_priors(arrays: Mapping[str, AnyArray]) -> Priors | None:
    """Return the priors of a saved result, checked."""
    if "priors_ids" not in arrays:
        return None
    return pose_priors(
        arrays["priors_ids"],
        arrays["priors_measurements"],
        arrays["priors_information"],
        offset=arrays.get("priors_offsets", None),
    )


def saved_landmarks(arrays: Mapping[str, AnyArray]) -> Landmarks | None:
    """Return the landmarks of a saved result, checked."""
    if "landmarks_ids" not in arrays:
        return None
    return landmarks(
        arrays["landmarks_observations"],
        arrays["landmarks_measurements"],
        arrays["landmarks_information"],
        ids=arrays["landmarks_ids"],
        positions=arrays.get("landmarks_positions", None),
        range_bearing=arrays.get("landmarks_range_bearing", False),
    )
