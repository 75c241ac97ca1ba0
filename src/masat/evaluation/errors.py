"""Errors of poses, and of the motions between them, by the definitions of evo."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np

from masat import lie
from masat.arrays import Floats, Ids, locked
from masat.errors import EvaluationError

Unit: TypeAlias = Literal["frames", "meters"]

# As evo's default: a path may be longer or shorter than asked for by this fraction.
_PATH_TOLERANCE = 0.1


@dataclass(frozen=True, eq=False)
class PoseErrors:
    """Errors of k poses or relative poses: of the transform E from the true to the estimated one.

    Attributes
    ----------
    translation : ndarray, (k,)
        Length of the translation of E, in meters.
    rotation : ndarray, (k,)
        Angle of the rotation of E, in radians, from 0 to pi.
    full : ndarray, (k,)
        Frobenius norm of E less the identity, both as 4x4 matrices. It has no unit.
    """

    translation: Floats
    rotation: Floats
    full: Floats

    def __post_init__(self) -> None:
        for name in ("translation", "rotation", "full"):
            self.__dict__[name] = locked(getattr(self, name))

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self.__post_init__()

    def statistics(self) -> dict[str, dict[str, float]]:
        """Return rmse, mean, median, std, min and max of each kind of error."""
        return {
            name: _statistics(getattr(self, name)) for name in ("translation", "rotation", "full")
        }


def errors_between(truth: Floats, poses: Floats) -> PoseErrors:
    """Return the errors of poses, (k, 7)."""
    step = lie.between(truth, poses)
    length = np.linalg.norm(step[:, :3], axis=1)
    sine = np.linalg.norm(step[:, 3:6], axis=1)
    # The squared norm of R - I is 8 sin^2 of half of the angle.
    return PoseErrors(
        translation=length,
        rotation=2 * np.arctan2(sine, np.abs(step[:, 6])),
        full=np.sqrt(length**2 + 8 * sine**2),
    )


def pairs_of_poses(positions: Floats, delta: float, unit: Unit, *, all_pairs: bool) -> Ids:
    """Return the indices of the poses, (k, 2), between which motions are compared.

    Parameters
    ----------
    positions : ndarray, (n, 3)
        Estimated positions, in the order of the trajectory.
    delta : float
        How far apart the poses of a pair are: a number of poses, or meters along the path.
    unit : {"frames", "meters"}
        Unit of `delta`.
    all_pairs : bool
        Whether a pair begins at each pose, or only where the pair before ends.
    """
    if unit not in ("frames", "meters"):
        raise EvaluationError(f'the unit of delta must be "frames" or "meters", got {unit!r}')
    if not 0 < delta < np.inf or (unit == "frames" and delta != int(delta)):
        what = "a positive integer" if unit == "frames" else "positive"
        raise EvaluationError(f"delta must be {what} in {unit}, got {delta!r}")
    if unit == "frames":
        ends = np.arange(0, len(positions), 1 if all_pairs else int(delta))
        step = int(delta) if all_pairs else 1
        pairs = np.column_stack([ends[:-step], ends[step:]])
    else:
        path = np.linalg.norm(np.diff(positions, axis=0), axis=1)
        pairs = _all_at_distance(path, delta) if all_pairs else _along(path, delta)
    if len(pairs) == 0:
        raise EvaluationError(
            f"no two of the {len(positions)} poses that were compared are {delta:g} {unit} apart: "
            "choose a smaller delta"
        )
    return pairs.astype(np.int64)


def _along(path: Floats, delta: float) -> Ids:
    """Return pairs that follow each other, each at least so long; `path` has the steps."""
    ends, traveled = [0], 0.0
    for k, step in enumerate(path.tolist(), 1):
        traveled += step
        if traveled >= delta:
            ends.append(k)
            traveled = 0.0
    return np.column_stack([ends[:-1], ends[1:]])


def _all_at_distance(path: Floats, delta: float) -> Ids:
    """Return for each pose the first of those after it at the distance closest to `delta`."""
    at = np.concatenate([[0.0], np.cumsum(path)])
    first, last = np.arange(len(at) - 1), len(at) - 1
    near = np.searchsorted(at, at[:-1] + delta)
    # The candidates: the first poses at the distances just below and just above.
    below = np.searchsorted(at, at[(near - 1).clip(0, last)])
    candidates = np.column_stack([below, near, near + 1]).clip(first[:, None] + 1, last)
    off = np.abs((at[candidates] - at[:-1, None]) - delta)
    best = off.argmin(axis=1)
    close = off[first, best] <= delta * _PATH_TOLERANCE
    pairs: Ids = np.column_stack([first, candidates[first, best]])[close]
    return pairs


def _statistics(errors: Floats) -> dict[str, float]:
    return {
        "rmse": float(np.sqrt(np.mean(errors**2))),
        "mean": float(errors.mean()),
        "median": float(np.median(errors)),
        "std": float(errors.std()),
        "min": float(errors.min()),
        "max": float(errors.max()),
    }
