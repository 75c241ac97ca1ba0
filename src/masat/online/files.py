"""Files of maps that grow."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import numpy as np

from masat import _checks as checks
from masat import lie
from masat.errors import FormatError
from masat.files import DAMAGED, write_atomically
from masat.graph import PoseGraph

_VERSION = 1
_ARRAYS = {
    "ids": np.int64,
    "poses": np.float64,
    "linearized": np.float64,
    "roots": np.int32,
    "edge_numbers": np.int64,
    "edges": np.int64,
    "measurements": np.float64,
    "information": np.float64,
}


def write_map(path: Path, dimension: int, tolerance: float, contents: dict[str, Any]) -> None:
    """Write the contents of the core's map to a file, whole or not at all."""
    about = {
        "version": _VERSION,
        "kind": "online map",
        "dimension": dimension,
        "tolerance": tolerance,
        "next_edge": contents["next_edge"],
    }
    buffer = io.BytesIO()
    arrays = {name: contents[name] for name in _ARRAYS}
    np.savez_compressed(buffer, about=np.array(json.dumps(about)), **arrays)
    write_atomically(path, buffer.getvalue())


def read_map(path: Path) -> tuple[int, float, dict[str, Any]]:
    """Return dimension, tolerance and contents of a map, checked.

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
            if not _fits(dimension, tolerance, contents):
                raise FormatError("the arrays of the map do not fit each other", path)
    except DAMAGED as error:
        if isinstance(error, FormatError):
            raise
        raise FormatError(f"not a map that OnlineMap.save wrote: {error}", path) from None
    return dimension, tolerance, contents


def _fits(dimension: int, tolerance: float, c: dict[str, Any]) -> bool:
    """Tell whether the contents are those of a map; ValueErrors tell more."""
    n, size, dof = len(c["ids"]), lie.POSE_SIZE[dimension], lie.DOF[dimension]
    m, numbers = len(c["edge_numbers"]), c["edge_numbers"]
    shapes = {
        "ids": (n,),
        "poses": (n, size),
        "linearized": (n, size),
        "roots": (n,),
        "edge_numbers": (m,),
        "edges": (m, 2),
        "measurements": (m, size),
        "information": (m, dof, dof),
    }
    if any(c[name].shape != shape for name, shape in shapes.items()) or not 0 <= tolerance < 1:
        return False
    in_range = (np.diff(numbers) > 0).all() and (numbers >= 0).all()
    if not in_range or (numbers >= c["next_edge"]).any():
        return False
    # The core takes quaternions only if their length is 1 up to rounding.
    for name in ("poses", "linearized"):
        checks.rotations(c[name], name, c["ids"], "node")
    checks.rotations(c["measurements"], "measurement", c["edges"], "edge")
    if n == 0:
        return len(numbers) == 0
    for poses in (c["poses"], c["linearized"]):
        PoseGraph.from_arrays(
            c["edges"], c["measurements"], c["information"], ids=c["ids"], poses=poses
        )
    # The first node of each component is fixed.
    graph = PoseGraph.from_arrays(
        c["edges"], c["measurements"], c["information"], ids=c["ids"], poses=c["poses"]
    )
    labels = graph.components[graph.index(c["ids"])]
    _, first, of_label = np.unique(labels, return_index=True, return_inverse=True)
    return bool((first[of_label] == c["roots"]).all())
