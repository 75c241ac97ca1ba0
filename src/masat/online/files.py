"""Files of maps that grow."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import numpy as np

from masat import _checks as checks
from masat import lie
from masat.arrays import AnyArray
from masat.errors import FormatError
from masat.files import DAMAGED, write_atomically
from masat.graph import PoseGraph
from masat.online.arrivals import STATES, is_kept, record_of
from masat.online.contents import graph_of, roots_of
from masat.online.sensor_rows import landmarks_of, priors_of, record_of_rows, rows_of

_VERSION = 3
_ARRAYS = {
    "ids": np.int64,
    "points": np.bool_,
    "poses": np.float64,
    "linearized": np.float64,
    "roots": np.int32,
    "edge_numbers": np.int64,
    "edges": np.int64,
    "measurements": np.float64,
    "information": np.float64,
    "sensor_numbers": np.int64,
    "sensor_ends": np.int32,
    "sensor_measurements": np.float64,
    "sensor_information": np.float64,
    "sensor_offsets": np.float64,
    "sensor_range_bearing": np.bool_,
}


def write_map(
    path: Path,
    dimension: int,
    tolerance: float,
    contents: dict[str, Any],
    closures: AnyArray | None = None,
) -> None:
    """Write the contents of the core's map to a file, and the closures of a robust one."""
    about = {
        "version": _VERSION,
        "kind": "online map",
        "dimension": dimension,
        "tolerance": tolerance,
        "next_edge": contents["next_edge"],
    }
    buffer = io.BytesIO()
    arrays = {name: contents[name] for name in _ARRAYS}
    arrays["waiting"] = contents["waiting"]
    if closures is not None:
        arrays["closures"] = closures
    np.savez_compressed(buffer, about=np.array(json.dumps(about)), **arrays)
    write_atomically(path, buffer.getvalue())


def read_map(path: Path) -> tuple[int, float, dict[str, Any], AnyArray | None]:
    """Return dimension, tolerance, contents and, of a robust map, closures; all are checked.

    Raises
    ------
    FormatError
        If the file holds something else.
    """
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
            about = json.loads(str(arrays["about"]))
            if about.get("kind") != "online map" or about["version"] != _VERSION:
                raise FormatError("not a map that OnlineMap.save of this version wrote", path)
            contents: dict[str, Any] = {
                name: np.ascontiguousarray(arrays[name], kind) for name, kind in _ARRAYS.items()
            }
            dimension, tolerance = int(about["dimension"]), float(about["tolerance"])
            contents["next_edge"] = int(about["next_edge"])
            closures, waiting = arrays.get("closures"), arrays["waiting"]
            contents["waiting"] = waiting
            if not (
                _fits(dimension, tolerance, contents)
                and _are_closures(closures, dimension, contents)
                and _are_waiting(waiting, dimension, contents)
            ):
                raise FormatError("the arrays of the map do not fit each other", path)
    except DAMAGED as error:
        if isinstance(error, FormatError):
            raise
        raise FormatError(f"not a map that OnlineMap.save wrote: {error}", path) from None
    return dimension, tolerance, contents, closures


def _fits(dimension: int, tolerance: float, c: dict[str, Any]) -> bool:
    """Tell whether the contents are those of a map; ValueErrors tell more."""
    n, size, dof = len(c["ids"]), lie.POSE_SIZE[dimension], lie.DOF[dimension]
    m, p = len(c["edge_numbers"]), len(c["sensor_numbers"])
    shapes = {
        "ids": (n,),
        "points": (n,),
        "poses": (n, size),
        "linearized": (n, size),
        "roots": (n,),
        "edge_numbers": (m,),
        "edges": (m, 2),
        "measurements": (m, size),
        "information": (m, dof, dof),
        "sensor_numbers": (p,),
        "sensor_ends": (p, 2),
        "sensor_measurements": (p, size),
        "sensor_information": (p, dof, dof),
        "sensor_offsets": (p, size),
        "sensor_range_bearing": (p,),
    }
    if any(c[name].shape != shape for name, shape in shapes.items()) or not 0 <= tolerance < 1:
        return False
    for numbers in (c["edge_numbers"], c["sensor_numbers"]):
        in_range = (numbers >= 0) & (numbers < c["next_edge"])
        if not in_range.all() or (np.diff(numbers) <= 0).any():
            return False
    if np.isin(c["sensor_numbers"], c["edge_numbers"]).any():
        return False
    # The core takes quaternions only if their length is 1 up to rounding.
    for name in ("poses", "linearized"):
        checks.rotations(c[name], name, c["ids"], "node")
    checks.rotations(c["measurements"], "measurement", c["edges"], "edge")
    if n == 0:
        return m == p == 0
    ends = c["sensor_ends"]
    if not (((ends >= -1) & (ends < n)).all() and (ends[:, 1] >= 0).all()):
        return False
    for name in ("sensor_measurements", "sensor_offsets"):
        checks.rotations(c[name], name, ends, "edge")
    if not _are_rows(rows_of(c), c):
        return False
    graph_of(c | {"poses": c["linearized"]})
    return bool((roots_of(graph_of(c), c["ids"]) == c["roots"]).all())


def _are_waiting(rows: AnyArray, dimension: int, c: dict[str, Any]) -> bool:
    """Tell whether these are priors and observations that wait; ValueErrors tell more."""
    if rows.dtype != record_of_rows(dimension) or rows.ndim != 1:
        return False
    known = np.concatenate([c["edge_numbers"], c["sensor_numbers"]])
    in_range = (rows["number"] >= 0) & (rows["number"] < c["next_edge"])
    if not in_range.all() or np.isin(rows["number"], known).any():
        return False
    return len(rows) == 0 or _are_rows(rows, c)


def _are_rows(rows: AnyArray, c: dict[str, Any]) -> bool:
    """Tell whether priors and observations are on nodes of a map; ValueErrors tell more."""
    ids, is_point = c["ids"], c["points"]
    seen = rows[~rows["is_prior"]]
    if not (
        np.isin(rows["node"], ids).all()
        and np.isin(seen["pose"], ids[~is_point]).all()
        and np.isin(seen["node"], ids[is_point]).all()
    ):
        return False
    d = 2 if c["poses"].shape[1] == 3 else 3
    # Makes the checks of each.
    priors_of(rows)
    landmarks_of(rows, ids[is_point], c["poses"][is_point, :d])
    return not seen["information"][:, d:].any()


def _are_closures(closures: AnyArray | None, dimension: int, c: dict[str, Any]) -> bool:
    """Tell whether closures are those of a map; ValueErrors tell more."""
    if closures is None:
        return True
    if closures.dtype != record_of(dimension) or closures.ndim != 1:
        return False
    if len(closures) == 0:
        return True
    numbers, ends, state = closures["number"], closures["ends"], closures["state"]
    if not ((state >= 0) & (state < STATES)).all():
        return False
    if (np.diff(numbers) <= 0).any() or not ((numbers >= 0) & (numbers < c["next_edge"])).all():
        return False
    if not ((ends > 0) & (ends <= len(c["ids"]))).all():
        return False
    if (c["ids"][ends - 1] != closures["ids"]).any():
        return False
    PoseGraph.from_arrays(
        closures["ids"], closures["measurement"], closures["information"], ids=c["ids"]
    )
    return bool((np.isin(numbers, c["edge_numbers"]) == is_kept(closures)).all())
