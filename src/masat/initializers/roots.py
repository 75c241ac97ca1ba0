"""Where a walk over the graph begins: one root a component, or the fixed nodes."""

from __future__ import annotations

import numpy as np

from masat import lie
from masat.arrays import Floats, Indices
from masat.errors import InitializationError
from masat.graph import PoseGraph


def roots_of(graph: PoseGraph, root: int | None) -> tuple[Indices, Floats, list[str]]:
    """Return the roots' indices, poses with the roots placed, and what to tell the user.

    A component begins at its fixed nodes, at their poses; without such, at `root` if that lies in
    it, or else at its smallest id. A root whose pose nobody fixed lies at the identity.
    """
    anchors = graph.gauge
    if root is not None:
        place = graph.index(root)
        components = graph.components
        component = components[place]
        if np.any(components[graph.index(graph.fixed)] == component):
            if root not in graph.fixed:
                raise InitializationError(
                    f"the root {root} is not fixed but its component holds fixed nodes, which "
                    "keep their poses: leave the root out, or name one of them"
                )
        else:
            anchors = np.sort(
                np.append(anchors[components[graph.index(anchors)] != component], root)
            )
    poses = np.tile(lie.identity(graph.dimension), (len(graph.ids), 1))
    places = graph.index(anchors)
    if graph.poses is not None:
        held = graph.index(graph.fixed)
        poses[held] = graph.poses[held]
    notes = []
    count = int(graph.components.max()) + 1
    if count > 1:
        shown = ", ".join(str(a) for a in anchors[:5]) + (", ..." if len(anchors) > 5 else "")
        notes.append(
            f"the graph has {count} components, each placed in a frame of its own, from the roots "
            f"{shown}: nothing measures how they lie to each other"
        )
    return places.astype(np.int32), poses, notes


def anchored(graph: PoseGraph) -> tuple[Floats, list[str]]:
    """Return poses with the anchors placed, for starts that have no root, and what to tell."""
    _, poses, notes = roots_of(graph, None)
    return poses, notes


def rooted(graph: PoseGraph, poses: Floats, root: int | None, notes: list[str]) -> PoseGraph:
    """Return the graph with poses, moved such that the root lies at the identity."""
    if root is None:
        return graph.with_poses(poses, notes=notes)
    roots_of(graph, root)  # refuses a root that fixed nodes exclude
    place = graph.index(root)
    if root not in graph.fixed:
        own = graph.components == graph.components[place]
        poses = poses.copy()
        poses[own] = lie.between(poses[place], poses[own])
        poses[place] = lie.identity(graph.dimension)
    return graph.with_poses(poses, notes=notes)
