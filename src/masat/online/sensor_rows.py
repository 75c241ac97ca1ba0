"""Priors and observations of a map that grows, as rows of one kind.

The core knows both as edges that may have a sensor offset or measure range and bearing: a prior
leads from the world to a node, an observation from a pose to a landmark (`assembly.py`).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from masat import _core, lie
from masat.arrays import AnyArray, Flags, Floats, Ids, Indices
from masat.information import partial
from masat.measurements import Landmarks, Priors, landmarks, pose_priors
from masat.residuals import measured_poses

# What the contents of the core's map call the columns, apart from the ids.
COLUMNS = {
    "sensor_numbers": "number",
    "sensor_measurements": "measurement",
    "sensor_information": "information",
    "sensor_offsets": "offset",
    "sensor_range_bearing": "range_bearing",
}


def record_of_rows(dimension: int) -> np.dtype[np.void]:
    """Return the type of the rows in which priors and observations of 2D or 3D are kept and saved.

    `pose` is the id of the pose that saw a landmark, and has no meaning for priors; `node` that of
    the landmark, or of the node that a prior is on.
    """
    dof, size = lie.DOF[dimension], lie.POSE_SIZE[dimension]
    return np.dtype(
        [
            ("number", np.int64),
            ("is_prior", np.bool_),
            ("pose", np.int64),
            ("node", np.int64),
            ("measurement", np.float64, (size,)),
            ("information", np.float64, (dof, dof)),
            ("offset", np.float64, (size,)),
            ("range_bearing", np.bool_),
            ("rejected", np.bool_),
        ]
    )


def rows_of_priors(priors: Priors) -> AnyArray:
    """Return priors as rows, without numbers."""
    rows: AnyArray = np.zeros(len(priors), record_of_rows(priors.dimension))
    rows["is_prior"], rows["node"] = True, priors.ids
    rows["measurement"], rows["information"] = priors.measurements, priors.information
    rows["offset"] = lie.identity(priors.dimension) if priors.offsets is None else priors.offsets
    return rows


def rows_of_observations(seen: Landmarks) -> AnyArray:
    """Return observations as rows, without numbers."""
    d = seen.dimension
    rows: AnyArray = np.zeros(len(seen.observations), record_of_rows(d))
    rows["pose"], rows["node"] = seen.observations.T
    rows["measurement"] = measured_poses(seen)
    rows["information"][:, :d, :d] = seen.information
    rows["offset"] = lie.identity(d)
    rows["range_bearing"] = seen.is_range_bearing
    return rows


def priors_of(rows: AnyArray) -> Priors | None:
    """Return those of the rows that are priors, checked; None if there are none."""
    own = rows[rows["is_prior"]]
    if len(own) == 0:
        return None
    return pose_priors(own["node"], own["measurement"], own["information"], offset=own["offset"])


def landmarks_of(rows: AnyArray, ids: Ids, positions: Floats) -> Landmarks | None:
    """Return landmarks at positions with those of the rows that are observations, checked."""
    if len(ids) == 0:
        return None
    own = rows[~rows["is_prior"]]
    d = positions.shape[1]
    z, polar = np.array(own["measurement"][:, :d]), own["range_bearing"]
    if polar.any():
        z[polar] = _ranges_and_angles(own["measurement"][polar], d)
    return landmarks(
        np.stack([own["pose"], own["node"]], 1),
        z,
        np.array(own["information"][:, :d, :d]),
        ids=ids,
        positions=positions,
        range_bearing=polar,
    )


def places(rows: AnyArray) -> Flags:
    """Tell which rows determine the position of a landmark by themselves."""
    d = 2 if rows["measurement"].shape[1] == 3 else 3
    out = np.ones(len(rows), np.bool_)
    out[partial(np.ascontiguousarray(rows["information"][:, :d, :d]))] = False
    return out


def ends_of(rows: AnyArray, core: _core.OnlineMap) -> Indices:
    """Return the indices of both nodes of each row in the core, (k, 2): the world is 0."""
    # They may wait for the next update.
    pairs = zip(rows["pose"].tolist(), rows["node"].tolist(), strict=True)
    ends = np.array([(core.find(a), core.find(b)) for a, b in pairs], np.int32).reshape(-1, 2)
    ends[rows["is_prior"], 0] = 0
    return ends


def add_to_core(core: _core.OnlineMap, rows: AnyArray, may_place: Flags | None = None) -> Ids:
    """Add rows to the core, those without a number under the next ones, and return their numbers.

    Parameters
    ----------
    core : OnlineMap
        The core's map.
    rows : structured ndarray, (k,)
        Priors and observations; all or none of them have a number, and none is -1.
    may_place : ndarray of bool, (k,), optional
        Which may place a landmark that nothing else measures. An edge that would join parts is left
        out of the map then. Default: all may join parts, which stay where they are.
    """
    first = core.next_edge()
    is_new = len(rows) > 0 and bool(rows["number"][0] < 0)
    core.add_sensor_edges(
        ends_of(rows, core),
        np.array(rows["measurement"]),
        np.array(rows["information"]),
        np.array(rows["offset"]),
        np.array(rows["range_bearing"]),
        may_place,
        None if is_new else np.array(rows["number"]),
    )
    return np.arange(first, core.next_edge()) if is_new else np.array(rows["number"])


def rows_of(contents: dict[str, Any]) -> AnyArray:
    """Return the priors and observations of the contents of a core's map."""
    ends, ids = contents["sensor_ends"], contents["ids"]
    d = 2 if contents["poses"].shape[1] == 3 else 3
    rows: AnyArray = np.zeros(len(ends), record_of_rows(d))
    for name, field in COLUMNS.items():
        rows[field] = contents[name]
    rows["is_prior"] = ends[:, 0] < 0
    seen = ~rows["is_prior"]
    rows["pose"][seen], rows["node"] = ids[ends[seen, 0]], ids[ends[:, 1]]
    return rows


def with_rows(contents: dict[str, Any], rows: AnyArray) -> dict[str, Any]:
    """Return contents with other priors and observations, which are sorted by their numbers."""
    rows = rows[np.argsort(rows["number"], kind="stable")]
    ends = np.stack([index_of(rows[name], contents["ids"]) for name in ("pose", "node")], 1)
    ends[rows["is_prior"], 0] = -1
    columns = {name: np.array(rows[field]) for name, field in COLUMNS.items()}
    return contents | columns | {"sensor_ends": np.ascontiguousarray(ends)}


def index_of(wanted: Ids, ids: Ids) -> Indices:
    """Return the index of each of the wanted ids among others, which are in any order.

    Where there is none, it is that of another id.
    """
    order = np.argsort(ids)
    at = np.searchsorted(ids, wanted, sorter=order).clip(max=max(len(ids) - 1, 0))
    out: Indices = order[at].astype(np.int32)
    return out


def _ranges_and_angles(poses: Floats, d: int) -> Floats:
    """Return the ranges and angles of which `measured_poses` made poses."""
    out = np.empty((len(poses), d))
    out[:, 0] = np.sqrt(np.square(poses[:, :d]).sum(axis=1))
    if d == 2:
        out[:, 1] = poses[:, 2]
        return out
    turn = _core.rotation_matrices(np.ascontiguousarray(poses))
    out[:, 1] = np.arctan2(-turn[:, 0, 1], turn[:, 1, 1])
    out[:, 2] = np.arctan2(turn[:, 2, 0], turn[:, 2, 2])
    return out
