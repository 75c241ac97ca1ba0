"""Files of maps that grow."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import numpy as np

from masat import lie
from masat.arrays import AnyArray, Ids, Indices
from masat.errors import FormatError
from masat.files import DAMAGED, write_atomically
from masat.graph import PoseGraph
from masat.online.arrivals import is_kept, record_of

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
            closures = arrays.get("closures")
            if not _fits(dimension, tolerance, contents) or not _belong(
                closures, dimension, contents
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
    numbers, roots = c["edge_numbers"], c["roots"]
    if c["poses"].shape != (n, size) or c["linearized"].shape != (n, size) or roots.shape != (n,):
        return False
    if c["information"].shape != (len(numbers), dof, dof) or not 0 <= tolerance < 1:
        return False
    in_range = (np.diff(numbers) > 0).all() and (numbers >= 0).all()
    if not in_range or (numbers >= c["next_edge"]).any() or c["measurements"].shape[1] != size:
        return False
    if n == 0:
        return len(numbers) == 0
    for poses in (c["poses"], c["linearized"]):
        PoseGraph.from_arrays(
            c["edges"], c["measurements"], c["information"], ids=c["ids"], poses=poses
        )
    graph = PoseGraph.from_arrays(
        c["edges"], c["measurements"], c["information"], ids=c["ids"], poses=c["poses"]
    )
    return bool((first_of_components(graph, c["ids"]) == roots).all())


def _belong(closures: AnyArray | None, dimension: int, c: dict[str, Any]) -> bool:
    """Tell whether closures are those of a map; ValueErrors tell more."""
    if closures is None:
        return True
    if closures.dtype != record_of(dimension) or closures.ndim != 1:
        return False
    numbers, ends = closures["number"], closures["ends"]
    if (np.diff(numbers) <= 0).any() or not ((numbers >= 0) & (numbers < c["next_edge"])).all():
        return False
    if not ((ends >= 0) & (ends < len(c["ids"]))).all():
        return False
    if (c["ids"][ends] != closures["ids"]).any():
        return False
    PoseGraph.from_arrays(
        closures["ids"], closures["measurement"], closures["information"], ids=c["ids"]
    )
    return bool((np.isin(numbers, c["edge_numbers"]) == is_kept(closures)).all())


def first_of_components(graph: PoseGraph, ids: Ids) -> Indices:
    """Return for each of the ids of a graph the index of the first one of its component, (n,).

    That one is fixed, if the ids are in the order in which they were added.
    """
    components = graph.components[graph.index(ids)]
    _, first, own = np.unique(components, return_index=True, return_inverse=True)
    return first[own].astype(np.int32)
