"""The checks of what is added to a map that grows; each failure is one error of the package."""

from __future__ import annotations

import operator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from masat import _checks as checks
from masat import _core, lie
from masat.arrays import Flags, Floats, Ids
from masat.errors import GraphError, InformationError
from masat.information import indefinite
from masat.measurements import Landmarks, Priors


def checked_id(node: Any) -> int:
    """Return an id as an integer of 64 bits."""
    try:
        out = operator.index(node)
    except TypeError:
        raise GraphError(f"an id must be an integer, got {node!r:.40}") from None
    if not -(2**63) <= out < 2**63:
        raise GraphError(f"an id must be an integer of 64 bits, got {out}")
    return out


def checked_guess(guess: ArrayLike, node: int, dimension: int) -> Floats:
    """Return a pose for a node."""
    row, size = checks.numbers("the guess", guess), lie.POSE_SIZE[dimension]
    if row.shape != (size,):
        raise GraphError(
            f"the guess of node {node} must have {size} numbers, got shape {row.shape}"
        )
    pose: Floats = checks.rotations(row[None].copy(), "guess", np.array([node]), "node")[0]
    return pose


def are_plain(edges: Any, measurements: Any, information: Any, dimension: int) -> bool:
    """Tell whether edges are arrays that the core can take as they are, if their numbers are valid.

    A front end that adds few edges at a time would spend most of its time on the checks otherwise.
    """
    if not (type(edges) is type(measurements) is type(information) is np.ndarray):
        return False
    if edges.ndim != 2 or edges.dtype != np.int64:
        return False
    m, dof = len(edges), lie.DOF[dimension]
    return (
        edges.shape[1] == 2
        and measurements.dtype == information.dtype == np.float64
        and measurements.shape == (m, lie.POSE_SIZE[dimension])
        and information.shape == (m, dof, dof)
        and all(
            array.flags.c_contiguous and array.flags.aligned
            for array in (edges, measurements, information)
        )
    )


def checked_edges(
    core: _core.OnlineMap,
    edges: Any,
    measurements: Any,
    information: ArrayLike | None,
    dimension: int,
) -> tuple[Ids, Floats, Floats]:
    """Return edges as arrays that the core takes.

    Parameters
    ----------
    core : OnlineMap
        The map, which knows the ids.
    edges, measurements, information
        As in `OnlineMap.add_edges`.
    dimension : int
        2 or 3.

    Raises
    ------
    GraphError, InformationError
        As `OnlineMap.add_edges`.
    """
    if np.ndim(edges) == 1 and np.ndim(measurements) == 1 and np.size(edges) == 2:
        edges, measurements = [edges], [measurements]
    pairs, size = checks.pairs_of_ids(edges), lie.POSE_SIZE[dimension]
    z = checks.table("measurements", measurements)
    if len(pairs) == 0 and z.size == 0:
        z = z.reshape(0, size)
    if z.shape != (len(pairs), size):
        raise GraphError(f"measurements must have shape ({len(pairs)}, {size}), got {z.shape}")
    for k, end in np.argwhere([[core.find(int(i)) < 0 for i in pair] for pair in pairs])[:1]:
        raise GraphError(
            f"{checks.edge_name(pairs, k)} names node {pairs[k, end]}, which has not been added: "
            "add it with add_pose",
            edge=int(k),
        )
    for k, end in np.argwhere([[core.is_point(int(i)) for i in pair] for pair in pairs])[:1]:
        raise GraphError(
            f"{checks.edge_name(pairs, k)} names node {pairs[k, end]}, which is a landmark: add "
            "what poses saw of it with add_observations",
            edge=int(k),
        )
    checks.no_loops(pairs)
    z = checks.rotations(z, "measurement", pairs, "edge")
    w = checks.information_matrices(information, pairs, lie.DOF[dimension])
    bad = indefinite(w)
    if len(bad):
        raise InformationError(
            f"the information of {len(bad)} of {len(w)} edges leaves a direction undetermined, "
            f"first of {checks.edge_name(pairs, int(bad[0]))}: an online map needs positive "
            "definite information",
            edge=int(bad[0]),
            count=len(bad),
        )
    return pairs, z, w


def check_priors(core: _core.OnlineMap, priors: Priors, dimension: int) -> None:
    """Refuse priors of another dimension, on unknown nodes, or on the rotation of a landmark.

    Raises
    ------
    GraphError
        As `OnlineMap.add_priors`.
    """
    if not isinstance(priors, Priors):
        raise GraphError(
            f"priors are made by masat.gps, masat.pose_priors and the like, got {type(priors)}"
        )
    if priors.dimension != dimension:
        raise GraphError(f"the map is {dimension}D, and the priors are {priors.dimension}D")
    turned: Flags = np.asarray(priors.information[:, dimension:].any(axis=(1, 2)))
    if priors.offsets is not None:
        turned |= (priors.offsets[:, :dimension] != 0).any(axis=1)
    for k, node in enumerate(priors.ids.tolist()):
        if core.find(node) < 0:
            raise GraphError(
                f"prior {k} names node {node}, which has not been added: add it with add_pose",
                node=node,
            )
        if turned[k] and core.is_point(node):
            raise GraphError(
                f"prior {k} of landmark {node} measures a rotation or has an offset: a point has a "
                "position alone",
                node=node,
            )


def check_observations(core: _core.OnlineMap, seen: Landmarks, dimension: int) -> None:
    """Refuse landmarks of another dimension, with the id of a pose, or seen by unknown poses.

    Raises
    ------
    GraphError
        As `OnlineMap.add_observations`.
    """
    if not isinstance(seen, Landmarks):
        raise GraphError(
            "observations are made by masat.landmarks or masat.range_bearing, got "
            f"{type(seen).__name__}"
        )
    if seen.dimension != dimension:
        raise GraphError(f"the map is {dimension}D, and the landmarks are {seen.dimension}D")
    for node in seen.ids.tolist():
        if core.find(node) >= 0 and not core.is_point(node):
            raise GraphError(
                f"the id {node} is that of a pose and of a landmark: choose another", node=node
            )
    if seen.positions is None:
        observed = set(seen.observations[:, 1].tolist())
        for node in seen.ids.tolist():
            if node not in observed and core.find(node) < 0:
                raise GraphError(
                    f"landmark {node} has neither an observation nor a position: leave it out",
                    node=node,
                )
    for k, (pose, point) in enumerate(seen.observations.tolist()):
        if core.find(pose) < 0 or core.is_point(pose):
            what = "is a landmark" if core.find(pose) >= 0 else "has not been added"
            raise GraphError(
                f"observation {k} ({pose} -> {point}) names pose {pose}, which {what}: add poses "
                "with add_pose",
                edge=k,
            )
