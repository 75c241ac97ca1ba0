"""pandas: the graph as tables of nodes, edges, priors and landmarks."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from masat.arrays import Floats
from masat.bridges.packages import package
from masat.chain import odometry_edges
from masat.errors import GraphError
from masat.graph import PoseGraph
from masat.measurements import Landmarks, Priors, landmarks, pose_priors

_POSE = {2: ("x", "y", "theta"), 3: ("x", "y", "z", "qx", "qy", "qz", "qw")}
_STEP = {2: ("x", "y", "theta"), 3: ("x", "y", "z", "qx", "qy", "qz")}
_POINT = {2: ("x", "y"), 3: ("x", "y", "z")}


class Frames(NamedTuple):
    """The tables of a graph.

    The columns of poses are x, y, theta in 2D and x, y, z, qx, qy, qz, qw in 3D. Those of
    information are its upper triangle: information_x_x, information_x_y and so on, qx, qy and qz
    being the vector part of the quaternion. Both are in the units of `PoseGraph`.

    Attributes
    ----------
    nodes : pandas.DataFrame
        A row for each node. The index is its id. Columns: the pose, `stamp`, `fixed`, and
        `component`. Notes of the graph are in `nodes.attrs["notes"]`.
    edges : pandas.DataFrame
        A row for each edge. The index is its index. Columns: `from`, `to`, the measurement, the
        information, `label`, `odometry`, and `chi2` if the graph has poses.
    priors : pandas.DataFrame or None
        A row for each prior: `node`, the measurement, the information, and `offset_x` and so on,
        the pose of the sensor.
    landmarks : pandas.DataFrame or None
        A row for each landmark. The index is its id. Columns: the position, if it is known.
    observations : pandas.DataFrame or None
        A row for each observation of a landmark: `pose`, `point`, the measurement in the columns
        x, y and in 3D z, the information, and `range_bearing`: where it is true the columns hold
        range, bearing and elevation.
    """

    nodes: Any
    edges: Any
    priors: Any = None
    landmarks: Any = None
    observations: Any = None


def to_pandas(graph: PoseGraph) -> Frames:
    """Return a graph as tables, without loss.

    `component`, `odometry` and `chi2` are computed; `from_pandas` does not read them.

    Raises
    ------
    MasatError
        If pandas is not installed.
    """
    pandas = package("pandas", "pandas")
    d = graph.dimension
    nodes = pandas.DataFrame(index=pandas.Index(graph.ids, name="id"))
    if graph.poses is not None:
        _add(nodes, _POSE[d], graph.poses)
    if graph.stamps is not None:
        nodes["stamp"] = graph.stamps
    nodes["fixed"] = np.isin(graph.ids, graph.fixed)
    nodes["component"] = graph.components
    if graph.notes:
        nodes.attrs["notes"] = graph.notes
    edges = pandas.DataFrame({"from": graph.edges[:, 0], "to": graph.edges[:, 1]})
    edges.index.name = "edge"
    _add(edges, _POSE[d], graph.measurements)
    _add_information(edges, _STEP[d], graph.information)
    if graph.labels is not None:
        edges["label"] = graph.labels.tolist()
    edges["odometry"] = odometry_edges(graph)
    if graph.poses is not None:
        edges["chi2"] = graph.chi2_per_edge
    return Frames(nodes, edges, _priors(pandas, graph.priors), *_landmarks(pandas, graph.landmarks))


def from_pandas(
    nodes: Any = None,
    edges: Any = None,
    priors: Any = None,
    landmarks: Any = None,
    observations: Any = None,
) -> PoseGraph:
    """Return tables as a graph: ``from_pandas(*to_pandas(graph))``.

    Parameters
    ----------
    nodes : pandas.DataFrame, optional
        As `Frames` describes it. The columns of the pose, `stamp` and `fixed` may be missing.
        Default: the nodes that the edges name, without poses.
    edges : pandas.DataFrame
        As `Frames` describes it. The information and `label` may be missing.
    priors, landmarks, observations : pandas.DataFrame, optional
        As `Frames` describes them.

    Returns
    -------
    PoseGraph

    Raises
    ------
    GraphError
        If a column is missing that is needed, or if the numbers are no valid graph, as
        `PoseGraph.from_arrays` says.
    """
    if edges is None:
        raise GraphError("give a table of edges")
    d = 3 if "z" in edges.columns else 2
    known = nodes is not None and "x" in nodes.columns
    return PoseGraph.from_arrays(
        _numbers(edges, ("from", "to"), "edges").reshape(-1, 2).astype(np.int64),
        _numbers(edges, _POSE[d], "edges"),
        _information(edges, _STEP[d], "edges"),
        ids=None if nodes is None else nodes.index.to_numpy(),
        poses=_numbers(nodes, _POSE[d], "nodes") if known else None,
        fixed=() if nodes is None or "fixed" not in nodes else nodes.index[nodes["fixed"]].tolist(),
        stamps=None if nodes is None or "stamp" not in nodes else nodes["stamp"].to_numpy(),
        labels=edges["label"].tolist() if "label" in edges and len(edges) else None,
        notes=() if nodes is None else nodes.attrs.get("notes", ()),
        priors=None if priors is None else _read_priors(priors, d),
        landmarks=None if observations is None else _read_landmarks(landmarks, observations, d),
    )


def _priors(pandas: Any, priors: Priors | None) -> Any:
    if priors is None:
        return None
    out = pandas.DataFrame({"node": priors.ids})
    _add(out, _POSE[priors.dimension], priors.measurements)
    _add_information(out, _STEP[priors.dimension], priors.information)
    if priors.offsets is not None:
        _add(out, _offsets(priors.dimension), priors.offsets)
    return out


def _read_priors(frame: Any, d: int) -> Priors:
    offset = _numbers(frame, _offsets(d), "priors") if "offset_x" in frame else None
    return pose_priors(
        _numbers(frame, ("node",), "priors").ravel().astype(np.int64),
        _numbers(frame, _POSE[d], "priors"),
        _information(frame, _STEP[d], "priors"),
        offset=offset,
    )


def _offsets(d: int) -> tuple[str, ...]:
    return tuple(f"offset_{name}" for name in _POSE[d])


def _landmarks(pandas: Any, seen: Landmarks | None) -> tuple[Any, Any]:
    if seen is None:
        return None, None
    points = pandas.DataFrame(index=pandas.Index(seen.ids, name="id"))
    if seen.positions is not None:
        _add(points, _POINT[seen.dimension], seen.positions)
    out = pandas.DataFrame({"pose": seen.observations[:, 0], "point": seen.observations[:, 1]})
    _add(out, _POINT[seen.dimension], seen.measurements)
    _add_information(out, _POINT[seen.dimension], seen.information)
    out["range_bearing"] = seen.is_range_bearing
    return points, out


def _read_landmarks(points: Any, frame: Any, d: int) -> Landmarks:
    known = points is not None and "x" in points
    return landmarks(
        _numbers(frame, ("pose", "point"), "observations").astype(np.int64),
        _numbers(frame, _POINT[d], "observations"),
        _information(frame, _POINT[d], "observations"),
        ids=None if points is None else points.index.to_numpy(),
        positions=_numbers(points, _POINT[d], "landmarks") if known else None,
        range_bearing=frame["range_bearing"].to_numpy(bool) if "range_bearing" in frame else False,
    )


def _add(frame: Any, names: tuple[str, ...], columns: Floats) -> None:
    for name, column in zip(names, columns.T, strict=True):
        frame[name] = column


def _add_information(frame: Any, names: tuple[str, ...], information: Floats) -> None:
    upper = np.triu_indices(len(names))
    _add(frame, _triangle(names), information[:, upper[0], upper[1]])


def _triangle(names: tuple[str, ...]) -> tuple[str, ...]:
    rows, columns = np.triu_indices(len(names))
    return tuple(f"information_{names[i]}_{names[j]}" for i, j in zip(rows, columns, strict=True))


def _information(frame: Any, names: tuple[str, ...], table: str) -> Floats | None:
    """Return the matrices, or None if the table has none."""
    if not any(name in frame.columns for name in _triangle(names)):
        return None
    upper = np.triu_indices(len(names))
    out = np.zeros((len(frame), len(names), len(names)))
    values = _numbers(frame, _triangle(names), table)
    out[:, upper[0], upper[1]] = values
    out[:, upper[1], upper[0]] = values
    return out


def _numbers(frame: Any, names: tuple[str, ...], table: str) -> Any:
    for name in names:
        if name not in frame.columns:
            raise GraphError(f"the table of {table} has no column {name!r}; needed: {names}")
    return frame[list(names)].to_numpy()
