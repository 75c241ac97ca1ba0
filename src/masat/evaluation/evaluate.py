"""Comparison of a map with the truth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from masat import lie
from masat.arrays import Floats, Ids, locked
from masat.errors import EvaluationError
from masat.evaluation.alignment import Align, aligned
from masat.evaluation.errors import PoseErrors, Unit, errors_between, pairs_of_poses
from masat.evaluation.matching import Match, matched
from masat.graph import PoseGraph


@dataclass(frozen=True, eq=False, repr=False)
class Evaluation:
    """How far a map is from the truth.

    Attributes
    ----------
    ate : PoseErrors
        Absolute trajectory errors: those of the k poses that were compared, after the alignment.
    rpe : PoseErrors
        Relative pose errors: those of the motions between pairs of these poses.
    ids : ndarray of int64, (k, 2)
        Ids of the nodes in the map and in the truth that were compared.
    pairs : ndarray of int64, (l, 2)
        Rows of `ids` between which the motions of `rpe` are.
    poses, truth : ndarray, (k, 7)
        The aligned poses and the true ones; 2D poses at z = 0.
    transform : ndarray, (7,)
        The alignment: a position p of the map becomes the transform of scale * p.
    scale : float
        1, unless the scale was aligned.
    matched_by : str
        "stamps" or "ids".
    align : str
        The kind of alignment.
    delta : float
        How far apart the poses of a pair are.
    unit : str
        Unit of `delta`: "frames" or "meters".
    notes : tuple of str
        What to know before the figures are trusted.
    """

    ate: PoseErrors
    rpe: PoseErrors
    ids: Ids
    pairs: Ids
    poses: Floats
    truth: Floats
    transform: Floats
    scale: float
    matched_by: str
    align: str
    delta: float
    unit: str
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name in ("ids", "pairs", "poses", "truth", "transform"):
            self.__dict__[name] = locked(getattr(self, name))

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self.__post_init__()

    def __repr__(self) -> str:
        ate, rpe = (e.statistics()["translation"]["rmse"] for e in (self.ate, self.rpe))
        return (
            f"Evaluation({len(self.ids)} poses matched by {self.matched_by}, rmse: ATE {ate:.6g} "
            f"m, RPE {rpe:.6g} m per {self.delta:g} {self.unit})"
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the figures as plain numbers, lists and strings."""
        return {
            "poses": len(self.ids),
            "matched_by": self.matched_by,
            "align": self.align,
            "transform": self.transform.tolist(),
            "scale": self.scale,
            "ate": self.ate.statistics(),
            "rpe": {
                "delta": self.delta,
                "unit": self.unit,
                "pairs": len(self.pairs),
                **self.rpe.statistics(),
            },
            "notes": list(self.notes),
        }


def evaluate(
    graph: PoseGraph,
    truth: PoseGraph,
    *,
    align: Align = "se3",
    match: Match = "auto",
    max_difference: float = 0.01,
    delta: float = 1,
    unit: Unit = "frames",
    all_pairs: bool = False,
) -> Evaluation:
    """Compare the poses of a map with the true ones: ATE and RPE, by the definitions of evo.

    Parameters
    ----------
    graph, truth : PoseGraph
        Graphs with poses, such as `masat.read` returns of graphs and trajectories. Edges do not
        count. 2D poses are compared with 3D poses at z = 0.
    align : {"se3", "sim3", "origin", "none"}
        How the map is moved before: "se3" by the rigid motion, and "sim3" by the similarity, with
        the smallest sum of squared distances of the positions (Umeyama, 1991); "origin" by the
        rigid motion of the first pose onto the first true one. In evo: ``--align``,
        ``--align --correct_scale`` and ``--align_origin``; evo's default is none.
    match : {"auto", "stamps", "ids"}
        How poses are matched. By stamp, each pose of the map with fewer poses is matched with the
        closest one of the other. "auto" takes the stamps if both have some, otherwise the ids.
    max_difference : float
        Largest difference of the stamps of two matched poses, in seconds.
    delta : float
        How far apart the poses of a pair are in the RPE.
    unit : {"frames", "meters"}
        Unit of `delta`: matched poses, in the order of stamps or ids, or meters along the
        estimated path.
    all_pairs : bool
        Whether the pairs of the RPE overlap: one begins at each pose. In meters those count whose
        length is within 10 % of `delta`. Otherwise a pair begins where the one before ends, and
        its path is at least `delta` long.

    Returns
    -------
    Evaluation

    Raises
    ------
    EvaluationError
        If a graph has no poses, if no poses match, if the positions do not determine the
        alignment, if no two poses are `delta` apart, or if an option has none of the values above.

    Examples
    --------
    >>> import masat
    >>> truth = masat.PoseGraph.from_arrays([(0, 1), (1, 2)], [(1, 0, 0)] * 2,
    ...                                     poses=[(0, 0, 0), (1, 0, 0), (2, 0, 0)])
    >>> graph = truth.with_poses([(5, 0, 0), (6, 0, 0), (7, 0.3, 0)])
    >>> masat.evaluate(graph, truth, align="origin").ate.translation.round(6).tolist()
    [0.0, 0.0, 0.3]
    """
    for name, given in (("map", graph), ("truth", truth)):
        if given.poses is None:
            raise EvaluationError(f"the {name} has no poses to compare")
    assert graph.poses is not None
    assert truth.poses is not None
    own, other, matched_by = matched(graph, truth, match, max_difference)
    true = lie.to_3d(truth.poses[other])
    poses, transform, scale = aligned(
        lie.to_3d(graph.poses[own]), true, align, planar=graph.dimension == truth.dimension == 2
    )
    pairs = pairs_of_poses(poses[:, :3], delta, unit, all_pairs=all_pairs)
    start, end = pairs.T
    return Evaluation(
        ate=errors_between(true, poses),
        rpe=errors_between(
            lie.between(true[start], true[end]), lie.between(poses[start], poses[end])
        ),
        ids=np.column_stack([graph.ids[own], truth.ids[other]]),
        pairs=pairs,
        poses=poses,
        truth=true,
        transform=transform,
        scale=scale,
        matched_by=matched_by,
        align=align,
        delta=float(delta),
        unit=unit,
        notes=_notes(graph, len(own), min(len(graph), len(truth))),
    )


def _notes(graph: PoseGraph, matches: int, possible: int) -> tuple[str, ...]:
    notes = []
    if matches < possible:
        notes.append(f"{possible - matches} of {possible} poses have no match and do not count")
    own_frames = len(np.setdiff1d(graph.gauge, graph.fixed))
    if len(graph.edges) and own_frames > 1:
        notes.append(
            f"the map has {own_frames} components in frames of their own, which one alignment "
            "cannot bring together: compare them one by one"
        )
    return tuple(notes)
