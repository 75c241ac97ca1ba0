"""Bounds of chi2 by boxes of relative rotations, against poses that are lower or might be."""

from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose
from random_graphs import random_graph

import masat
from masat import lie
from masat.assembly import with_edges
from masat.optimality.bounds import TIGHT, chi2_bound
from masat.optimality.branching import Box, _Branching, _most_mixed, branched_bound
from masat.progress import Progress
from masat.worlds import manhattan, perturb


def at_minimum(graph):
    """The graph at the minimum that the search ends at, exactly."""
    return masat.optimize(masat.solve(graph).graph, relative_tolerance=1e-12).graph


def loose(seed):
    """A world at whose minimum the relaxation is not tight, for some seeds."""
    world = manhattan(200, 300, seed=seed)
    return at_minimum(perturb(world, (0.4, 0.4, 0.4), seed=seed))


@pytest.mark.parametrize("seed", [8, 10, 11])
def test_a_minimum_is_proven_where_the_relaxation_alone_is_not_tight(seed):
    graph = loose(seed)
    chi2 = graph.chi2
    assert chi2 - chi2_bound(graph, chi2) > 5e-4 * chi2
    bound, lower = branched_bound(graph, chi2)
    assert chi2 * (1 - TIGHT / 2) <= bound <= chi2
    assert lower is None
    assert masat.certify(graph, search=False).status == "undecided"
    assert masat.certify(graph).certified


@pytest.mark.filterwarnings("ignore::masat.MasatWarning")
@pytest.mark.parametrize("seed", range(30))
def test_no_poses_are_below_the_bound(seed):
    graph = at_minimum(random_graph(2, 12, 12, seed, noise=0.7))
    rng = np.random.default_rng(seed)
    lowest = graph.chi2
    for _ in range(20):
        start = lie.retract(graph.poses, rng.normal(size=(len(graph), 3)) * 2)
        lowest = min(lowest, masat.optimize(graph.with_poses(start), "lm").chi2)
    bound, lower = branched_bound(graph, graph.chi2)
    assert bound <= lowest * (1 + 1e-9)
    assert lower is None or lower.chi2 < graph.chi2


@pytest.mark.parametrize("seed", [0, 8])
def test_a_worse_minimum_is_not_proven(seed):
    graph = loose(seed)
    starts = [masat.initialize(graph, init) for init in ("odometry", "spanning_tree", "masat")]
    minima = [masat.optimize(start, "lm", relative_tolerance=1e-12) for start in starts]
    worse = [m for m in minima if m.converged and m.chi2 > graph.chi2 * (1 + TIGHT)]
    assert worse
    for result in worse:
        bound, lower = branched_bound(result.graph, result.chi2)
        assert bound <= graph.chi2 * (1 + 1e-9)
        assert lower is None or lower.chi2 < result.chi2


def test_poses_that_are_no_minimum_are_lowered():
    graph = loose(8)
    moved = lie.retract(graph.poses, np.random.default_rng(0).normal(size=(len(graph), 3)) * 1e-4)
    above = graph.with_poses(moved)
    for fraction in (3e-7, 7e-7, 1e-5):
        bound, lower = branched_bound(above, graph.chi2 * (1 + fraction))
        assert bound == 0
        assert lower.chi2 == pytest.approx(graph.chi2)


def test_fixed_nodes_have_no_loose_rotation():
    graph = loose(10).with_fixed([0, 5])
    assert not _Branching(graph, graph.chi2, 0, Progress())._is_loose((0, 5))


def test_a_box_exceeds_chi2_by_no_more_than_it_says():
    graph = loose(10)
    branching = _Branching(graph, graph.chi2, 0, Progress())
    pair, rng = (3, 120), np.random.default_rng(0)
    assert branching._is_loose(pair)
    angle = graph.poses[pair[1], 2] - graph.poses[pair[0], 2]
    for _ in range(200):
        width, at = rng.uniform(0.01, np.pi), rng.uniform(-4, 4)
        box = Box({pair: (angle + at - width, angle + at + width)}, graph.poses)
        poses = graph.poses.copy()
        poses[:, 2] += rng.normal(size=len(poses))
        poses[pair[1], 2] = poses[pair[0], 2] + angle + at + rng.uniform(-width, width)
        confined = branching._confined(box).with_poses(poses)
        more = confined.chi2 - graph.with_poses(poses).chi2
        assert -1e-9 <= more <= branching._exceeds(box) * (1 + 1e-9)


def test_the_boxes_of_a_division_are_the_whole():
    graph = loose(10)
    branching = _Branching(graph, graph.chi2, 0, Progress())
    pair, waiting = (5, 77), []
    middle = branching._angle(pair)
    waiting = [Box({pair: (middle - np.pi, middle + np.pi)}, graph.poses)]
    for _ in range(12):
        box = waiting.pop(0)
        parts = branching._divided(box, pair, graph.poses)
        ends = [part.arcs[pair] for part in parts]
        assert len(parts) > 1
        assert ends[0][0] == box.arcs[pair][0]
        assert ends[-1][1] == box.arcs[pair][1]
        assert all(a[1] == b[0] for a, b in pairwise(ends))
        waiting += parts


def test_the_stiffness_of_a_relative_rotation_is_its_inverse_variance():
    graph = loose(10)
    branching = _Branching(graph, graph.chi2, 0, Progress())
    assert not branching._is_loose((7, 7))
    for pair in ((0, 50), (3, 120)):
        assert branching._is_loose(pair)
        of_pair = masat.relative_covariances(graph, [graph.ids[list(pair)]])
        assert_allclose(branching._weight(pair), 1 / of_pair[0, 2, 2], rtol=1e-6)


def test_the_most_mixed_pair_is_found():
    # Ten nodes whose frames differ in phase, the last three turned out of the first number too.
    frames = np.zeros((10, 4, 2))
    frames[:, 0, 0], frames[:, 1, 0] = np.cos(range(10)), np.sin(range(10))
    frames[7:, :, 0] *= np.cos(np.radians(80))
    frames[7:, 0, 1] = np.sin(np.radians(80))
    pair, length = _most_mixed(frames)
    assert pair[0] < 7 <= pair[1]
    assert length == pytest.approx(np.cos(np.radians(80)))


def test_more_edges_change_chi2_by_their_own():
    graph = loose(8)
    measured, information = np.array([[0.0, 0, 0.5]]), np.diag([0.0, 0, 3])[None]
    more = with_edges(graph, graph.ids[[[0, 9]]], measured, information)
    turned = graph.poses[9, 2] - graph.poses[0, 2] - 0.5
    turned = np.arctan2(np.sin(turned), np.cos(turned))
    assert more.chi2 == pytest.approx(graph.chi2 + 3 * turned**2)
