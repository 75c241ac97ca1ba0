"""The nodes of a view: positions in each map, orientation, times, sessions and covariances."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from masat import lie
from masat.arrays import AnyArray, Floats
from masat.chain import sessions
from masat.covariance import covariances
from masat.graph import PoseGraph
from masat.viewing.payload import single
from masat.viewing.states import State


def center_of(graph: PoseGraph) -> tuple[Floats, float]:
    """Return the center of a map, (d,), and half of the diagonal of the box around it, in meters.

    Positions are stored relative to the center in single precision, which keeps seven digits.
    """
    assert graph.poses is not None
    positions = graph.poses[:, : graph.dimension]
    low, high = positions.min(axis=0), positions.max(axis=0)
    radius = float(np.sqrt(np.square(high - low).sum())) / 2
    return (low + high) / 2, max(radius, 1e-3)


def node_arrays(
    graph: PoseGraph, states: Sequence[State], center: Floats, *, with_covariances: bool
) -> tuple[dict[str, AnyArray], dict[str, Any]]:
    """Return the arrays of the payload, and what its header says of them."""
    d = graph.dimension
    positions = np.array([state.poses[:, :d] for state in states]) - center
    assert graph.poses is not None
    arrays: dict[str, AnyArray] = {
        "ids": graph.ids,
        "positions": single(positions),
        "rotations": single(graph.poses[:, d:]),
        "gauge": graph.index(graph.gauge).astype(np.int32),
    }
    header: dict[str, Any] = {"fixed": [str(node) for node in graph.fixed.tolist()[:1000]]}
    of_node = sessions(graph)
    if of_node.max() > 0:
        arrays["session"] = of_node.astype(np.int32)
    if graph.components.max() > 0:
        arrays["component"] = graph.components
    if graph.stamps is not None:
        first = graph.stamps.min()
        seconds = (graph.stamps - first) * (1e-9 if graph.stamps.dtype.kind == "i" else 1.0)
        arrays["stamps"] = seconds.astype(np.float64)
        header["first_stamp"] = str(first)
    if with_covariances:
        arrays["covariances"] = single(_position_covariances(graph))
    return arrays, header


def _position_covariances(graph: PoseGraph) -> Floats:
    """Return the upper triangles of the covariances of positions along the world's axes."""
    assert graph.poses is not None
    d = graph.dimension
    own = covariances(graph)[:, :d, :d]
    # The axes of each node in the world's frame, as columns.
    ahead = np.tile(lie.identity(d), (d, 1))
    ahead[:, :d] = np.eye(d)
    tips = lie.compose(graph.poses[:, None], ahead)[..., :d]
    axes = (tips - graph.poses[:, None, :d]).swapaxes(-1, -2)
    world = axes @ own @ axes.swapaxes(-1, -2)
    i, j = np.triu_indices(d)
    return np.asarray(world[:, i, j])
