"""Simulated position fixes, as satellite navigation gives them, some of them far off."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from masat import _core, lie
from masat.arrays import Flags, Floats
from masat.errors import GraphError
from masat.graph import PoseGraph
from masat.measurements import Priors, gps
from masat.residuals import as_poses
from masat.worlds.closures import check_seed
from masat.worlds.noise import ZERO_SIGMA

BAD_METERS = 50.0
"""How far bad fixes are from the true position by default."""


def add_fixes(
    graph: PoseGraph,
    fraction: float,
    sigma: float,
    *,
    bad: float = 0.0,
    bad_distance: float = BAD_METERS,
    frame: ArrayLike | None = None,
    seed: int = 0,
) -> tuple[PoseGraph, Flags]:
    """Add position fixes to a graph whose map is known.

    Parameters
    ----------
    graph : PoseGraph
        A graph with its true poses.
    fraction : float
        Fraction of the nodes that have a fix, in [0, 1]; they are drawn at random.
    sigma : float
        Standard deviation of each coordinate, in meters. A sigma of 0 leaves the fixes exact, with
        the information of `ZERO_SIGMA`.
    bad : float
        Fraction of the fixes that are bad, in [0, 1].
    bad_distance : float
        How far bad fixes are from the true position before the noise, in meters, in any direction.
    frame : array_like, (3,) or (7,), optional
        Pose of the frame of the graph in the frame of the fixes, such as east, north, up. The
        poses, landmarks and earlier priors of the new graph are in the frame of the fixes. Default:
        both are the same.
    seed : int
        Seed of the random numbers.

    Returns
    -------
    graph : PoseGraph
        The graph with the fixes after the priors that it has, and its poses in their frame.
    is_bad : ndarray of bool, (p,)
        Which priors of the new graph are bad fixes.

    Raises
    ------
    GraphError
        If the graph has no poses, or a fraction, a sigma, a distance, the frame or the seed is not
        as above.
    """
    check_fraction("the fraction of nodes with a fix", fraction)
    check_fraction("the fraction of bad fixes", bad)
    check_length("the sigma of fixes", sigma)
    check_length("the distance of bad fixes", bad_distance)
    check_seed(seed)
    true_poses(graph, "fixes")
    if frame is not None:
        graph = _moved(graph, _checked_frame(frame, graph))
    poses = true_poses(graph, "fixes")
    d, random = graph.dimension, np.random.default_rng([seed, 3])
    nodes = np.sort(random.choice(len(graph), round(fraction * len(graph)), replace=False))
    is_bad = np.zeros(len(nodes), np.bool_)
    is_bad[random.choice(len(nodes), round(bad * len(nodes)), replace=False)] = True
    direction = random.normal(size=(len(nodes), d))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    noise = sigma * random.normal(size=(len(nodes), d))
    fixes = poses[nodes, :d] + noise + bad_distance * is_bad[:, None] * direction
    own = 0 if graph.priors is None else len(graph.priors)
    if len(nodes):
        added = gps(graph.ids[nodes], fixes, sigma or ZERO_SIGMA)
        graph = graph.with_priors(added if graph.priors is None else [graph.priors, added])
    return graph, np.concatenate([np.zeros(own, np.bool_), is_bad])


def _moved(graph: PoseGraph, frame: Floats) -> PoseGraph:
    """Return the graph with its poses, landmarks and priors in the frame of the fixes."""
    out = graph.with_poses(lie.compose(frame, true_poses(graph, "fixes")))
    if graph.points is not None:
        d = graph.dimension
        out = out.with_points(lie.compose(frame, as_poses(graph.points))[:, :d])
    return out if graph.priors is None else out.with_priors(_moved_priors(graph.priors, frame))


def _moved_priors(priors: Priors, frame: Floats) -> Priors:
    """Return priors in another frame; their residuals at moved poses are the same."""
    d = priors.dimension
    moved = lie.compose(frame, priors.measurements)
    information = priors.information.copy()
    # Positions alone have the axes of their new frame, as those that `gps` makes.
    positions = ~information[:, d:].any(axis=(1, 2))
    turn = _core.rotation_matrices(np.ascontiguousarray(moved[positions]))
    moved[positions] = as_poses(moved[positions, :d])
    turned = turn @ information[positions, :d, :d] @ turn.transpose(0, 2, 1)
    information[positions, :d, :d] = (turned + turned.transpose(0, 2, 1)) / 2
    return replace(priors, measurements=moved, information=information)


def true_poses(graph: PoseGraph, what: str) -> Floats:
    """Return the poses of a graph, which must have some."""
    if graph.poses is None:
        raise GraphError(f"{what} are simulated at the true poses, and the graph has none")
    return graph.poses


def check_fraction(name: str, value: float) -> None:
    """Refuse what is no number from 0 to 1."""
    if not _is_number(value) or not 0 <= value <= 1:
        raise GraphError(f"{name} must be from 0 to 1, got {value!r:.40}")


def check_length(name: str, value: float) -> None:
    """Refuse what is no finite number of meters of at least 0."""
    if not _is_number(value) or not 0 <= value < np.inf:
        raise GraphError(f"{name} must be finite and not negative, got {value!r:.40}")


def _is_number(value: object) -> bool:
    return isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)


def _checked_frame(frame: ArrayLike, graph: PoseGraph) -> Floats:
    size = lie.POSE_SIZE[graph.dimension]
    pose = np.asarray(frame, np.float64)
    if pose.shape != (size,) or not np.isfinite(pose).all():
        raise GraphError(f"the frame of fixes must be a pose of {size} finite numbers")
    if size == 7:
        norm = np.linalg.norm(pose[3:])
        if not 0.99 < norm < 1.01:
            raise GraphError("the rotation of the frame of fixes must be a unit quaternion")
        pose = np.append(pose[:3], pose[3:] / norm)
    return pose
