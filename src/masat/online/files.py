"""Files of maps that grow."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import numpy as np

from masat import _checks as checks
from masat import lie
from masat.arrays import AnyArray, Ids, Indices
from masat.errors import FormatError
from masat.files import DAMAGED, write_atomically
from masat.graph import PoseGraph
from masat.measurements.priors import Priors, pose_priors
from masat.online.arrivals import STATES, is_kept, record_of
from masat.online.waiting_priors import record_of_priors

_VERSION = 2
_ARRAYS = {
    "ids": np.int64,
    "poses": np.float64,
    "linearized": np.float64,
    "roots": np.int32,
    "edge_numbers": np.int64,
    "edges": np.int64,
    "measurements": np.float64,
    "information": np.float64,
    "prior_numbers": np.int64,
    "prior_ids": np.int64,
    "prior_measurements": np.float64,
    "prior_information": np.float64,
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


def graph_of(contents: dict[str, Any]) -> PoseGraph:
    """Return the graph of a map's contents."""
    d = contents["poses"].shape[1]
    priors = Priors(
        contents["prior_ids"],
        contents["prior_measurements"].reshape(-1, d),
        contents["prior_information"],
    )
    return PoseGraph.from_arrays(
        contents["edges"],
        contents["measurements"].reshape(-1, d),
        contents["information"],
        ids=contents["ids"],
        poses=contents["poses"],
        priors=priors if len(priors) else None,
    )


def _fits(dimension: int, tolerance: float, c: dict[str, Any]) -> bool:
    """Tell whether the contents are those of a map; ValueErrors tell more."""
    n, size, dof = len(c["ids"]), lie.POSE_SIZE[dimension], lie.DOF[dimension]
    m, p = len(c["edge_numbers"]), len(c["prior_numbers"])
    shapes = {
        "ids": (n,),
        "poses": (n, size),
        "linearized": (n, size),
        "roots": (n,),
        "edge_numbers": (m,),
        "edges": (m, 2),
        "measurements": (m, size),
        "information": (m, dof, dof),
        "prior_numbers": (p,),
        "prior_ids": (p,),
        "prior_measurements": (p, size),
        "prior_information": (p, dof, dof),
    }
    if any(c[name].shape != shape for name, shape in shapes.items()) or not 0 <= tolerance < 1:
        return False
    for numbers in (c["edge_numbers"], c["prior_numbers"]):
        in_range = (numbers >= 0) & (numbers < c["next_edge"])
        if not in_range.all() or (np.diff(numbers) <= 0).any():
            return False
    if np.isin(c["prior_numbers"], c["edge_numbers"]).any():
        return False
    # The core takes quaternions only if their length is 1 up to rounding.
    for name in ("poses", "linearized"):
        checks.rotations(c[name], name, c["ids"], "node")
    checks.rotations(c["measurements"], "measurement", c["edges"], "edge")
    if n == 0:
        return m == p == 0
    if p:
        pose_priors(c["prior_ids"], c["prior_measurements"], c["prior_information"])
    graph_of(c | {"poses": c["linearized"]})
    return bool((roots_of(graph_of(c), c["ids"]) == c["roots"]).all())


def roots_of(graph: PoseGraph, ids: Ids) -> Indices:
    """Return the fixed node of the component of each of a graph's ids, (n,).

    It is given by its index among these, which are in the order in which they were added: the first
    one of the component, or -1 for the world if the component has priors.
    """
    at = graph.index(ids)
    components = graph.structure.components
    tied = np.zeros(int(components.max(initial=0)) + 1, np.bool_)
    if graph.priors is not None:
        tied[components[graph.index(graph.priors.ids)]] = True
    _, first, own = np.unique(components[at], return_index=True, return_inverse=True)
    return np.where(tied[components[at]], -1, first[own]).astype(np.int32)


def _are_waiting(rows: AnyArray, dimension: int, c: dict[str, Any]) -> bool:
    """Tell whether these are priors that wait; ValueErrors tell more."""
    if rows.dtype != record_of_priors(dimension) or rows.ndim != 1:
        return False
    if not ((rows["node"] > 0) & (rows["node"] <= len(c["ids"]))).all():
        return False
    if (c["ids"][rows["node"] - 1] != rows["id"]).any():
        return False
    if len(rows):
        pose_priors(rows["id"], rows["measurement"], rows["information"])
    known = np.concatenate([c["edge_numbers"], c["prior_numbers"]])
    in_range = (rows["number"] >= 0) & (rows["number"] < c["next_edge"])
    return bool(in_range.all() and not np.isin(rows["number"], known).any())


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
