"""What the measurements leave undetermined: kept at the initial guess, or refused, and named."""

from __future__ import annotations

import numpy as np

from masat import _core
from masat.arrays import Flags, Floats
from masat.assembly import Assembly
from masat.errors import OptimizationError
from masat.freedoms import Freedom, body_of_each_node, undetermined, unmeasured_landmarks

# So many bodies have a note of their own; the others share one.
_MAX_NOTES = 5
_NUMBERS = {1: "one", 2: "two", 3: "three"}


def with_undetermined_kept(assembly: Assembly) -> tuple[Assembly, list[str]]:
    """Return the assembly with what is undetermined kept at its poses, and a note of each."""
    found, graph = undetermined(assembly), assembly.graph
    position, none = np.eye(graph.dimension), np.zeros((0, graph.dof - graph.dimension))
    unmeasured = [
        Freedom(int(node), 1, position, none, exact=True) for node in unmeasured_landmarks(assembly)
    ]
    if not found:
        return assembly, _notes(assembly, unmeasured)
    assert graph.poses is not None
    d, dof = graph.dimension, graph.dof
    nodes = np.array([freedom.node for freedom in found])
    turn = _core.rotation_matrices(np.ascontiguousarray(graph.poses[nodes]))
    weight = np.median(np.einsum("kii->ki", graph.information), axis=0)
    weight = np.where(weight > 0, weight, 1.0)
    information = np.zeros((len(found), dof, dof))
    for k, freedom in enumerate(found):
        own = freedom.translations @ turn[k]
        information[k, :d, :d] = weight[:d].mean() * own.T @ own
        axes = freedom.rotations if d == 2 else freedom.rotations @ turn[k]
        information[k, d:, d:] = weight[d:].mean() * axes.T @ axes
    kept = assembly.with_edges_from_world(nodes, graph.poses[nodes], information)
    return kept, _notes(assembly, found + unmeasured)


def refuse_undetermined(assembly: Assembly, what: str) -> None:
    """Raise an OptimizationError that names what is not determined, if anything is not."""
    found = undetermined(assembly)
    if found:
        said = _sentence(assembly, found[0], then="")
        raise OptimizationError(f"{what}: {said}")


def _notes(assembly: Assembly, found: list[Freedom]) -> list[str]:
    """Return a sentence for each of the first bodies, and one for the rest."""
    notes = [_sentence(assembly, freedom) for freedom in found[:_MAX_NOTES]]
    if len(found) > _MAX_NOTES:
        rest = ", ".join(str(assembly.graph.ids[f.node]) for f in found[_MAX_NOTES:][:5])
        notes.append(
            f"{len(found) - _MAX_NOTES} more nodes are not determined in some direction, such as "
            f"{rest}: they stay there at the initial guess"
        )
    return notes


def _sentence(
    assembly: Assembly, freedom: Freedom, then: str = "; kept at the initial guess"
) -> str:
    graph = assembly.graph
    d, node = graph.dimension, int(graph.ids[freedom.node])
    is_point = bool(assembly.is_point[freedom.node])
    if freedom.size > 1:
        what = f"the {freedom.size} poses that are joined to node {node}"
    else:
        what = f"landmark {node}" if is_point else f"node {node}"
    free = []
    a, b = len(freedom.translations), len(freedom.rotations)
    if a == d:
        free.append("position")
    elif a:
        free.append("position along " + " and ".join(map(_axis, freedom.translations)))
    if b:
        if d == 2:
            free.append("heading")
        elif b == 3:
            free.append("rotation")
        else:
            free.append("rotation about " + " and ".join(map(_axis, freedom.rotations)))
    if is_point:
        cure = "an observation from another place"
    elif a and b:
        cure = "a prior on the full pose, or an edge of full information"
    elif a:
        cure = "a position fix, or an edge of full information"
    else:
        cure = ("a heading" if d == 2 else "a rotation prior") + ", or position fixes of other "
        cure += "nodes off that axis" if d == 3 else "nodes"
    return (
        f"{what}: {' and '.join(free)} not determined ({_seen(assembly, freedom)}){then}. "
        f"{cure[0].upper()}{cure[1:]} would determine it"
    )


def _axis(direction: Floats) -> str:
    for k, name in enumerate("xyz"[: len(direction)]):
        if abs(direction[k]) > 1 - 1e-6:
            return name
    shown = ", ".join(f"{value:.2g}" for value in direction)
    return f"({shown})"


def _seen(assembly: Assembly, freedom: Freedom) -> str:
    """Say what measures a body."""
    graph, source = assembly.graph, assembly.source
    bodies = body_of_each_node(assembly)
    own = np.flatnonzero(bodies == bodies[freedom.node])
    touching: Flags = np.asarray(np.isin(graph.edge_indices, own).any(axis=1))
    inside: Flags = np.asarray(np.isin(graph.edge_indices, own).all(axis=1))
    priors = int(np.count_nonzero(touching[assembly.prior_rows]))
    seen = int(np.count_nonzero(touching[assembly.observation_rows]))
    edges = touching[: len(source.edges)] & ~inside[: len(source.edges)]
    partly = int(np.count_nonzero(edges))
    parts = [
        f"{_NUMBERS.get(count, count)} {noun}{end if count > 1 else one}"
        for count, (noun, one, end) in (
            (priors, _kind_of_priors(assembly, touching)),
            (seen, ("observation", "", "s")),
            (partly, ("partial edge", "", "s")),
        )
        if count
    ]
    return "seen only by " + " and ".join(parts) if parts else "nothing measures it"


def _kind_of_priors(assembly: Assembly, touching: Flags) -> tuple[str, str, str]:
    """Return what the priors of a body measure, and the endings of one and of several."""
    d, rows = assembly.graph.dimension, assembly.prior_rows
    information = assembly.graph.information[rows][touching[rows]]
    turned = information[:, d:, d:].any(axis=(1, 2))
    placed = information[:, :d, :d].any(axis=(1, 2))
    if not turned.any():
        if d == 3 and not information[:, :2, :2].any():
            return "altitude", "", "s"
        return "position fix", "", "es"
    return (
        ("heading prior" if d == 2 else "rotation prior") if not placed.any() else "prior",
        "",
        "s",
    )
