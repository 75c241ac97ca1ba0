"""JSON robot logs (JRL): gtsam's factors of one robot or several as JSON.

Source: McGann and others, JRL, https://github.com/DanMcGann/jrl, the pages in its folder `format`.
Covariances are in gtsam's order: of a pose in 3D rotation vector and translation, of bearing and
range the bearing first.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from masat import lie
from masat.arrays import Floats
from masat.errors import FormatError, GraphError, InformationError
from masat.formats.table import Format
from masat.graph import PoseGraph
from masat.information import from_rotation_vectors
from masat.measurements import Landmarks, Priors, pose_priors, range_bearing
from masat.measurements.landmarks import joined_landmarks

_POSES, _POINTS = {"Pose2": 2, "Pose3": 3}, {"Point2": 2, "Point3": 3}
_EDGES = {f"BetweenFactor{name}": d for name, d in _POSES.items()}
_POSE_PRIORS = {f"PriorFactor{name}": d for name, d in _POSES.items()}
_POINT_PRIORS = {f"PriorFactor{name}": d for name, d in _POINTS.items()}
_RANGES = {"RangeFactor2D": 2, "RangeFactor3D": 3}
_BEARINGS = {"BearingRangeFactor2D": 2, "BearingRangeFactor3D": 3}
# A covariance of a direction in 3D counts as isotropic to this fraction.
_ISOTROPIC = 1e-6


def read_graph(text: bytes, path: Path) -> PoseGraph:
    """Return the graph of a JSON robot log: all robots in one, the initialization as poses.

    Raises
    ------
    FormatError
        If the text is no such log; it names the line, or the robot, entry and measurement.
    """
    try:
        log = json.loads(text)
    except json.JSONDecodeError as error:
        raise FormatError(f"not JSON: {error.msg}", path, error.lineno) from None
    except (UnicodeDecodeError, RecursionError) as error:
        raise FormatError(f"not JSON: {error}", path) from None
    if not isinstance(log, dict) or not isinstance(log.get("measurements"), dict):
        raise FormatError('no JSON robot log: it has no map "measurements" from robots', path)
    found = _Found()
    for where, measurement in _measurements(log["measurements"], path):
        try:
            found.add(measurement)
        except (KeyError, TypeError, ValueError, OverflowError, np.linalg.LinAlgError) as error:
            what = f"no {error}" if isinstance(error, KeyError) else str(error)
            raise FormatError(f"{where}: {what}", path) from None
    try:
        return found.graph(_values(log.get("initialization"), path), _notes(log, found))
    except (GraphError, InformationError) as error:
        raise FormatError(str(error), path) from None


def _measurements(robots: dict[str, Any], path: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield each measurement and the words that say where it stands."""
    for robot, entries in robots.items():
        if not isinstance(entries, list):
            raise FormatError(f"robot {robot!r}: expected a list of entries", path)
        for k, entry in enumerate(entries):
            inside = entry.get("measurements") if isinstance(entry, dict) else None
            if not isinstance(inside, list):
                raise FormatError(f'robot {robot!r}, entry {k}: no list "measurements"', path)
            for j, measurement in enumerate(inside):
                where = f"robot {robot!r}, entry {k}, measurement {j}"
                if not isinstance(measurement, dict) or "type" not in measurement:
                    raise FormatError(f"{where}: expected an object with a type", path)
                yield where, measurement


class _Found:
    """The measurements of a log, by kind."""

    def __init__(self) -> None:
        self.skipped: Counter[str] = Counter()
        self.rounded = 0
        self._edges: list[tuple[tuple[int, int], Floats, Floats]] = []
        self._priors: list[Priors] = []
        self._seen: list[tuple[tuple[int, int], float, Floats | None, Floats]] = []
        self._dimension = 0

    def add(self, measurement: dict[str, Any]) -> None:
        kind = measurement["type"]
        kinds = _EDGES | _POSE_PRIORS | _POINT_PRIORS | _RANGES | _BEARINGS
        if kind not in kinds:
            self.skipped[str(kind)] += 1
            return
        d = kinds[kind]
        if self._dimension not in (0, d):
            raise ValueError(f"a {kind} is in {d}D, but measurements before it are not")
        self._dimension = d
        covariance = np.array(measurement["covariance"], np.float64)
        size = round(covariance.size**0.5)
        covariance = covariance.reshape(size, size)
        if kind in _EDGES:
            w = _information(covariance, lie.DOF[d])
            ends = _key(measurement["key1"]), _key(measurement["key2"])
            self._edges.append((ends, _pose(measurement["measurement"], d), w))
        elif kind in _POSE_PRIORS:
            w = _information(covariance, lie.DOF[d])[None]
            self._priors.append(
                pose_priors([_key(measurement["key"])], [_pose(measurement["prior"], d)], w)
            )
        elif kind in _POINT_PRIORS:
            # A prior on a position, of which the information is that of a pose in the world's axes.
            w = np.zeros((1, lie.DOF[d], lie.DOF[d]))
            w[0, :d, :d] = _inverse(covariance, d)
            at = lie.identity(d)
            at[:d] = _point(measurement["prior"], d)
            self._priors.append(pose_priors([_key(measurement["key"])], at[None], w))
        else:
            self._observe(measurement, kind, covariance, d)

    def _observe(self, measurement: dict[str, Any], kind: str, covariance: Floats, d: int) -> None:
        ends = _key(measurement["key1"]), _key(measurement["key2"])
        if kind in _RANGES:
            sigma = np.full(d, np.inf)
            sigma[0] = _variances(covariance, 1)[0] ** 0.5
            self._seen.append((ends, float(measurement["measurement"]), None, sigma))
            return
        value = measurement["measurement"]
        variances = _variances(covariance, d)
        if d == 3 and abs(variances[0] - variances[1]) > _ISOTROPIC * variances[0]:
            self.rounded += 1
            variances[:2] = variances[:2].mean()
        if covariance.size > 1 and np.abs(covariance - np.diag(np.diag(covariance))).any():
            self.rounded += 1
        sigma = np.sqrt(np.concatenate([variances[-1:], variances[:-1]]))
        direction = np.array(value["bearing"], np.float64).ravel()
        if direction.shape != ((1,) if d == 2 else (3,)):
            raise ValueError("a bearing is an angle in 2D and a vector of three numbers in 3D")
        if d == 3:
            x, y, z = direction
            direction = np.array([np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))])
        self._seen.append((ends, float(value["range"]), direction, sigma))

    def graph(self, values: dict[int, Floats], notes: list[str]) -> PoseGraph:
        d = self._dimension
        if d == 0:
            raise GraphError("the log holds no measurement that masat knows")
        seen = self._landmarks()
        points = np.empty(0, np.int64) if seen is None else seen.ids
        edges = np.array([ends for ends, _, _ in self._edges], np.int64).reshape(-1, 2)
        z = np.array([pose for _, pose, _ in self._edges]).reshape(-1, lie.POSE_SIZE[d])
        w = np.array([w for _, _, w in self._edges]).reshape(-1, lie.DOF[d], lie.DOF[d])
        graph = PoseGraph.from_arrays(
            edges, z, w, priors=self._priors or None, landmarks=seen, notes=notes
        )
        known = [values.get(node) for node in graph.ids.tolist()]
        if known and all(pose is not None and len(pose) == lie.POSE_SIZE[d] for pose in known):
            graph = graph.with_poses(np.array(known))
        where = [values.get(point) for point in points.tolist()]
        if where and all(point is not None and len(point) == d for point in where):
            graph = graph.with_points(np.array(where))
        return graph

    def _landmarks(self) -> Landmarks | None:
        """Return what was seen, those of which ranges alone were measured by themselves."""
        parts: list[Landmarks] = []
        for with_bearing in (True, False):
            own = [row for row in self._seen if (row[2] is not None) == with_bearing]
            if not own:
                continue
            ends = np.array([row[0] for row in own], np.int64)
            ranges, sigma = np.array([row[1] for row in own]), np.array([row[3] for row in own])
            if not with_bearing:
                parts.append(
                    range_bearing(ends, ranges, sigma_range=sigma[:, 0], dimension=self._dimension)
                )
                continue
            directions = np.array([row[2] for row in own])
            in_3d = self._dimension == 3
            parts.append(
                range_bearing(
                    ends,
                    ranges,
                    directions[:, 0],
                    directions[:, 1] if in_3d else None,
                    sigma_range=sigma[:, 0],
                    sigma_bearing=sigma[:, 1],
                    sigma_elevation=sigma[:, 2] if in_3d else None,
                )
            )
        return joined_landmarks(parts) if parts else None


def _notes(log: dict[str, Any], found: _Found) -> list[str]:
    notes = [
        f"{count} measurement{'' if count == 1 else 's'} of the type {kind[:40]} skipped: not "
        "supported"
        for kind, count in found.skipped.items()
    ]
    if found.rounded:
        notes.append(
            f"{found.rounded} covariances of bearing and range taken as uncorrelated, and in 3D as "
            "equal in all directions"
        )
    for name, meaning in (
        ("groundtruth", "true poses"),
        ("outlier_factors", "which measurements are false"),
    ):
        if log.get(name):
            notes.append(f"{name} of the log: {meaning}, is not read")
    return notes


def _values(robots: Any, path: Path) -> dict[int, Floats]:
    """Return the poses, (3,) or (7,), and points, (2,) or (3,), of an initialization."""
    out: dict[int, Floats] = {}
    if robots is None:
        return out
    try:
        for values in robots.values():
            for key, value in values.items():
                kind = value["type"]
                if kind in _POSES:
                    out[_key(key)] = _pose(value, _POSES[kind])
                elif kind in _POINTS:
                    out[_key(key)] = _point(value, _POINTS[kind])
    except (AttributeError, KeyError, TypeError, ValueError, OverflowError) as error:
        raise FormatError(f"initialization: {error}", path) from None
    return out


def _key(key: Any) -> int:
    number = int(key)
    if not 0 <= number < 2**63 - 1:
        raise ValueError(f"the key {number} is no id of a node: from 0 to 2^63 - 2")
    return number


def _pose(value: dict[str, Any], d: int) -> Floats:
    if d == 2:
        return np.array([float(value["x"]), float(value["y"]), float(value["theta"])])
    translation = [float(number) for number in value["translation"]]
    w, x, y, z = (float(number) for number in value["rotation"])
    if len(translation) != 3:
        raise ValueError("a translation has three numbers")
    return np.array([*translation, x, y, z, w])


def _point(value: dict[str, Any], d: int) -> Floats:
    return np.array([float(value[axis]) for axis in "xyz"[:d]])


def _variances(covariance: Floats, size: int) -> Floats:
    if covariance.shape != (size, size):
        raise ValueError(f"the covariance must have {size * size} numbers")
    variances = np.diag(covariance).copy()
    if not (np.isfinite(variances) & (variances > 0)).all():
        raise ValueError("variances must be positive")
    return variances


def _information(covariance: Floats, dof: int) -> Floats:
    """Return information in g2o's order and scale."""
    return from_rotation_vectors(_inverse(covariance, dof))


def _inverse(covariance: Floats, size: int) -> Floats:
    _variances(covariance, size)
    w = np.linalg.inv(covariance)
    return np.asarray(w + w.T) / 2


FORMAT = Format(
    name="jrl",
    summary="JRL: a JSON robot log with gtsam's factors",
    records=(),
    read_text=read_graph,
)
