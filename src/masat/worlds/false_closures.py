"""False loop closures: what a front end proposes when two places look alike."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple, TypeAlias

import numpy as np

from masat import lie
from masat.arrays import Flags, Floats, Ids
from masat.chain import odometry_edges
from masat.errors import GraphError
from masat.freedoms import degrees_of_freedom
from masat.graph import PoseGraph
from masat.information import inverse_root, partial
from masat.worlds.closures import MAX_COUNT, check_seed
from masat.worlds.noise import with_noise

FALSE_LABEL = "false"
"""Label of the false loop closures in a graph whose labels are strings."""

# chi2 at the clean map that every false loop closure exceeds, by degrees of freedom: far beyond
# what a true one reaches, since only one in 100,000 exceeds 25.9 or 33.1.
_MIN_CHI2 = {3: 40.0, 6: 60.0}
# Standard deviations of a false measurement around the identity, as in Vertigo: a place recognizer
# reports that the robot is back where it was.
_SIGMA_METERS = 0.3
_SIGMA_RADIANS = np.radians(10)
# Largest number of nodes from the first to the second node of a local false loop closure.
_MAX_LOCAL_GAP = 20
# Number of consecutive pairs in a run of kind "grouped" or "alias".
_RUN_LENGTH = 20
# Runs that are drawn at once, and how often none of them may be false before the search ends.
_MIN_BATCH = 64
_MAX_FAILED_BATCHES = 100


class _Runs(NamedTuple):
    """Drawn runs: poses at both ends of each pair, (r, l, 3 or 7), and information."""

    first: Floats
    second: Floats
    information: Floats


_Measure: TypeAlias = Callable[[_Runs, np.random.Generator], Floats]


class _Kind(NamedTuple):
    """How many pairs a run has, how far apart they are, and how they are measured."""

    length: int
    max_gap: int | None
    measure: _Measure


def add_false_closures(
    graph: PoseGraph, kind: str, fraction: float, *, seed: int = 0
) -> tuple[PoseGraph, Flags]:
    """Add false loop closures to a graph whose map is known.

    Each false loop closure joins two nodes that are not consecutive, from the earlier to the later
    one. It has the information of a random true loop closure, and at the poses of the graph its
    chi2 exceeds 40 in 2D or 60 in 3D.

    Parameters
    ----------
    graph : PoseGraph
        A graph without false edges at its optimum. Odometry is the first edge between each pair of
        consecutive ids, and all other edges are true loop closures. If the information is off by a
        common factor, pass `normalized(graph)`.
    kind : {"random", "local", "grouped", "alias"}
        - "random": pairs of nodes drawn uniformly. The measurement is normal around the identity
          with 0.3 m and 10 degrees for each axis.
        - "local": as "random", but the second node is at most 20 nodes later than the first.
        - "grouped": runs of 20 consecutive pairs (a, b), (a + 1, b + 1), ... with one measurement,
          drawn as in "random".
        - "alias": runs of 20 consecutive pairs that agree with each other. One wrong transform
          moves the poses at b, b + 1, ... next to a, a + 1, ...; the first measurement is drawn as
          in "random", and noise drawn from the information is added to each.
    fraction : float
        Fraction of the false among all loop closures of the new graph, in [0, 1).
    seed : int
        Seed of the random numbers.

    Returns
    -------
    graph : PoseGraph
        The graph with the false loop closures after its own edges. In a graph with labels they get
        the label "false" among strings and -1 among integers.
    is_false : ndarray of bool, (m,)
        Which edges of the new graph are false.

    Raises
    ------
    GraphError
        If the kind is unknown, if the fraction is not in [0, 1), if the graph has no poses, no loop
        closures or too few nodes, or if its information is so small that no false loop closure
        stands out.

    Notes
    -----
    Source of the measurements of "random", "local" and "grouped": N. Suenderhauf, P. Protzel,
    Switchable constraints for robust pose graph SLAM, IROS 2012, and its program Vertigo.
    """
    chosen = _checked_kind(kind)
    check_seed(seed)
    if graph.poses is None:
        raise GraphError(
            "false loop closures are told from true ones at the poses of the map, and the graph "
            "has none: solve it first"
        )
    closures = np.flatnonzero(~odometry_edges(graph))
    count = _false_count(fraction, len(closures))
    if count == 0:
        return graph, np.zeros(len(graph.edges), np.bool_)
    nodes = len(graph.ids)
    if nodes < chosen.length + 2:
        raise GraphError(
            f"false loop closures of kind {kind!r} need at least {chosen.length + 2} nodes, and "
            f"the graph has {nodes}"
        )
    random = np.random.default_rng([seed, 2])
    pairs, measurements, information = _draw(
        graph.poses, graph.information[closures], chosen, count, random
    )
    labels = FALSE_LABEL if graph.labels is not None and graph.labels.dtype.kind == "U" else None
    spoiled = graph.with_edges(graph.ids[pairs], measurements, information, labels=labels)
    return spoiled, np.arange(len(spoiled.edges)) >= len(graph.edges)


def normalized(graph: PoseGraph) -> PoseGraph:
    """Return the graph with information that fits its residuals: with a reduced chi2 of 1.

    The information of public graphs is often off by a common factor, by which that of all edges,
    priors and observations is divided here.

    Parameters
    ----------
    graph : PoseGraph
        A graph without false edges at its optimum.

    Returns
    -------
    PoseGraph

    Raises
    ------
    GraphError
        If the graph has no poses, if its measurements are no more than its unknowns, or if they are
        exact: there are no residuals then to compare the information with.
    """
    redundancy = degrees_of_freedom(graph)
    if redundancy <= 0:
        raise GraphError("the graph has no reduced chi2: its measurements are not redundant")
    factor = graph.chi2 / redundancy
    # Exact measurements leave a chi2 of rounding errors.
    if not factor > np.finfo(np.float64).eps:
        raise GraphError(
            f"the reduced chi2 is {factor:.3g}: the measurements are exact, so that their "
            "residuals tell nothing about their information"
        )
    priors, seen = graph.priors, graph.landmarks
    return replace(
        graph,
        information=graph.information / factor,
        priors=priors and replace(priors, information=priors.information / factor),
        landmarks=seen and replace(seen, information=seen.information / factor),
    )


def _checked_kind(kind: str) -> _Kind:
    if kind not in KINDS:
        raise GraphError(
            f"there is no kind {kind!r:.40} of false loop closures: choose one of "
            f"{', '.join(KINDS)}"
        )
    return KINDS[kind]


def _false_count(fraction: float, true_count: int) -> int:
    """Return how many false loop closures make this fraction of all."""
    try:
        value = float(fraction)
    except (TypeError, ValueError):
        value = np.nan
    if not 0 <= value < 1:
        raise GraphError(
            f"the fraction of false loop closures must be at least 0 and below 1, got "
            f"{fraction!r:.40}"
        )
    if true_count == 0:
        raise GraphError(
            "the graph has no loop closures, whose number and information false ones are made from"
        )
    count = round(value / (1 - value) * true_count)
    if count > MAX_COUNT:
        raise GraphError(f"{count} false loop closures are more than the {MAX_COUNT} possible")
    return count


def _draw(
    poses: Floats, information: Floats, kind: _Kind, count: int, random: np.random.Generator
) -> tuple[Ids, Floats, Floats]:
    """Draw runs until they have `count` pairs, and return pairs, measurements and information.

    A run is drawn again unless each of its edges exceeds the smallest chi2.
    """
    dof = information.shape[1]
    drawn: list[tuple[Ids, Floats, Floats]] = []
    missing, failed = -(-count // kind.length), 0
    while missing:
        batch = max(missing, _MIN_BATCH)
        pairs = _run_pairs(len(poses), kind, batch, random)
        matrices = information[random.integers(len(information), size=pairs.shape[:2])]
        runs = _Runs(poses[pairs[..., 0]], poses[pairs[..., 1]], matrices)
        measurements = kind.measure(runs, random)
        residuals = lie.local(measurements, lie.between(runs.first, runs.second))
        chi2 = np.einsum("...i,...ij,...j->...", residuals, matrices, residuals)
        kept = np.flatnonzero((chi2 > _MIN_CHI2[dof]).all(axis=1))[:missing]
        drawn.append((pairs[kept], measurements[kept], matrices[kept]))
        missing -= len(kept)
        failed = 0 if len(kept) else failed + 1
        if failed == _MAX_FAILED_BATCHES:
            raise GraphError(
                f"no false loop closures with a chi2 above {_MIN_CHI2[dof]:g} were found in "
                f"{failed * batch} draws: the information of the loop closures is too small, or "
                "the map too short, to tell true from false"
            )
    # Whole runs were drawn: the last one loses the pairs beyond the count.
    all_pairs, z, w = (np.concatenate(parts) for parts in zip(*drawn, strict=True))
    size = poses.shape[1]
    return (
        all_pairs.reshape(-1, 2)[:count],
        z.reshape(-1, size)[:count],
        w.reshape(-1, dof, dof)[:count],
    )


def _run_pairs(nodes: int, kind: _Kind, runs: int, random: np.random.Generator) -> Ids:
    """Draw runs of pairs (earlier, later), (runs, length, 2), as indices of nodes."""
    starts = nodes - kind.length + 1  # the nodes where a run may begin
    if kind.max_gap is None:
        # Of all pairs at least two apart, each is as likely: pairs of distinct numbers, one smaller
        # and the later one moved by one.
        first = random.integers(starts - 1, size=runs)
        second = (first + random.integers(1, starts - 1, size=runs)) % (starts - 1)
        first, second = np.minimum(first, second), np.maximum(first, second) + 1
    else:
        first = random.integers(starts - 2, size=runs)
        second = random.integers(first + 2, np.minimum(first + kind.max_gap, starts - 1) + 1)
    begin = np.stack([first, second], axis=-1)
    pairs: Ids = begin[:, None] + np.arange(kind.length)[:, None]
    return pairs


def _near_identity(count: int, size: int, random: np.random.Generator) -> Floats:
    """Draw measurements around the identity, (count, 3 or 7)."""
    dimension = 2 if size == 3 else 3
    turns = lie.DOF[dimension] - dimension
    sigma = np.repeat([_SIGMA_METERS, _SIGMA_RADIANS], [dimension, turns])
    exact = np.tile(lie.identity(dimension), (count, 1))
    return with_noise(exact, sigma * random.normal(size=(count, len(sigma))))


def _constant(runs: _Runs, random: np.random.Generator) -> Floats:
    """Return one measurement around the identity for all pairs of a run."""
    count, length, size = runs.first.shape
    return np.repeat(_near_identity(count, size, random)[:, None], length, axis=1)


def _consistent(runs: _Runs, random: np.random.Generator) -> Floats:
    """Return measurements that move all second poses of a run by one wrong transform, with noise.

    The transform T takes the first of them next to its partner: pose(a) z = T pose(b), with z drawn
    around the identity.
    """
    begin = _constant(runs, random)[:, :1]
    wrong = lie.compose(lie.compose(runs.first[:, :1], begin), lie.inverse(runs.second[:, :1]))
    exact = lie.between(runs.first, lie.compose(wrong, runs.second))
    dof = runs.information.shape[-1]
    unit = random.normal(size=(*exact.shape[:2], dof, 1))
    noise = _noise(runs.information.reshape(-1, dof, dof), unit.reshape(-1, dof, 1))
    step = lie.retract(lie.identity(2 if dof == 3 else 3), noise.reshape(unit.shape[:3]))
    return lie.compose(exact, lie.inverse(step))


def _noise(information: Floats, unit: Floats) -> Floats:
    """Return noise of this information, (k, d, 1), made of unit noise; unmeasured directions: 0."""
    out = np.empty_like(unit)
    is_partial = np.zeros(len(information), np.bool_)
    is_partial[partial(information)] = True
    # With the information W = L L', the residual L'^-1 u has the covariance W^-1.
    upper = np.linalg.cholesky(information[~is_partial]).swapaxes(-1, -2)
    out[~is_partial] = np.linalg.solve(upper, unit[~is_partial])
    out[is_partial] = inverse_root(information[is_partial]) @ unit[is_partial]
    return out


KINDS = {
    "random": _Kind(1, None, _constant),
    "local": _Kind(1, _MAX_LOCAL_GAP, _constant),
    "grouped": _Kind(_RUN_LENGTH, None, _constant),
    "alias": _Kind(_RUN_LENGTH, None, _consistent),
}
"""The kinds of false loop closures, by name."""
