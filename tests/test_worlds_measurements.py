"""Simulated fixes and landmarks."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import masat
from masat import GraphError, lie
from masat.worlds import add_fixes, add_landmarks, manhattan, perturb, sphere

FRAMES = {2: (500.0, -200, 2.0), 3: (500.0, -200, 7, 0, 0, np.sin(1), np.cos(1))}


@pytest.mark.parametrize("world", [manhattan, sphere])
def test_exact_fixes_lie_in_their_frame(world):
    truth = world(200)
    d = truth.dimension
    graph, is_bad = add_fixes(truth, 0.25, 0.0, frame=FRAMES[d], seed=3)
    assert len(graph.priors) == 50
    assert not is_bad.any()
    where = truth.index(graph.priors.ids)
    expected = lie.compose(np.array(FRAMES[d]), truth.poses[where])[:, :d]
    assert_allclose(graph.priors.measurements[:, :d], expected, atol=1e-9)
    assert graph.chi2 < 1e-6
    # Without its poses the map is found in the frame of the fixes.
    poses = masat.solve(graph).poses
    assert_allclose(poses[:, :d], graph.poses[:, :d], atol=1e-6)


def test_bad_fixes_are_far_off_and_the_others_near():
    graph, is_bad = add_fixes(manhattan(1000), 0.5, 0.1, bad=0.3, bad_distance=40, seed=1)
    off = graph.priors.measurements[:, :2] - graph.poses[graph.index(graph.priors.ids), :2]
    distance = np.linalg.norm(off, axis=1)
    assert (len(is_bad), is_bad.sum()) == (500, 150)
    assert_allclose(distance[is_bad], 40, atol=0.6)
    assert (distance[~is_bad] < 0.6).all()
    assert off[~is_bad].std() == pytest.approx(0.1, rel=0.1)
    assert_allclose(graph.priors.information[0], np.diag([100, 100, 0]))


def test_seeds_decide():
    truth = manhattan(300)
    one, other, third = (add_fixes(truth, 0.2, 1.0, bad=0.2, seed=s)[0].priors for s in (4, 4, 5))
    assert_array_equal(one.measurements, other.measurements)
    assert len(one) == len(third)
    assert not np.array_equal(one.ids, third.ids)
    a, b, c = (add_landmarks(truth, 20, seed=s).landmarks for s in (4, 4, 5))
    assert_array_equal(a.measurements, b.measurements)
    assert not np.array_equal(a.positions, c.positions)


def test_fixes_follow_the_priors_of_the_graph():
    truth = manhattan(100).with_priors(masat.headings([5], [0.1], 0.1))
    graph, is_bad = add_fixes(truth, 0.1, 1.0, bad=1.0)
    assert graph.priors.ids[0] == 5
    assert is_bad.tolist() == [False] + [True] * 10
    assert perturb(graph, [0.1, 0.1, 0.1]).priors is graph.priors


@pytest.mark.parametrize("world", [manhattan, sphere])
def test_exact_landmarks_are_found(world):
    truth = world(200)
    graph = add_landmarks(truth, 30, sigma=0.0, reach=4.0, seed=2)
    seen = graph.landmarks
    assert len(seen) == 30
    assert seen.ids.tolist() == list(range(200, 230))
    assert (np.linalg.norm(seen.measurements, axis=1) <= 4.0 + 1e-9).all()
    assert (np.bincount(seen.observations[:, 1] - 200, minlength=30) >= 2).all()
    assert graph.chi2_per_observation.max() < 1e-6
    result = masat.solve(graph.with_landmarks(masat.landmarks(
        seen.observations, seen.measurements, seen.information, ids=seen.ids
    )))  # fmt: skip
    distance = [np.linalg.norm(p[:, None] - p, axis=2) for p in (result.graph.points, graph.points)]
    assert_allclose(distance[0], distance[1], atol=1e-6)


def test_noise_of_observations_is_as_large_as_said_and_nothing_else_depends_on_it():
    truth = manhattan(1000)
    exact, noisy = (add_landmarks(truth, 100, sigma=s, observations=900, seed=1) for s in (0, 0.2))
    assert_array_equal(exact.points, noisy.points)
    assert_array_equal(exact.landmarks.observations, noisy.landmarks.observations)
    off = noisy.landmarks.measurements - exact.landmarks.measurements
    assert off.shape == (900, 2)
    assert off.std() == pytest.approx(0.2, rel=0.1)
    assert noisy.chi2_per_observation.sum() == pytest.approx(1800, rel=0.15)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((1.5, 1.0), "the fraction of nodes with a fix must be from 0 to 1, got 1.5"),
        ((0.5, -1.0), "the sigma of fixes must be finite and not negative"),
        ((0.5, np.nan), "the sigma of fixes must be finite"),
        ((0.5, 1.0, {"bad": 2}), "the fraction of bad fixes"),
        ((0.5, 1.0, {"frame": (0, 0)}), "must be a pose of 3 finite numbers"),
        ((0.5, 1.0, {"seed": -1}), "a seed must not be negative"),
    ],
)
def test_bad_fixes_are_refused(arguments, message):
    fraction, sigma, options = (*arguments, {})[:3]
    with pytest.raises(GraphError, match=message):
        add_fixes(manhattan(50), fraction, sigma, **options)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"count": -1}, "must not be negative"),
        ({"count": 1.5}, "count must be an integer"),
        ({"count": 3, "reach": 0.0}, "their reach not 0"),
        ({"count": 3, "sigma": -1}, "the sigma of observations"),
        ({"count": 3, "observations": 10**6}, "are within reach, but 1000000 observations"),
    ],
)
def test_impossible_landmarks_are_refused(options, message):
    with pytest.raises(GraphError, match=message):
        add_landmarks(manhattan(50), **options)


def test_a_graph_without_poses_is_refused():
    graph = masat.PoseGraph.from_arrays([(0, 1)], [(1, 0, 0)])
    for add in (lambda: add_fixes(graph, 0.5, 1.0), lambda: add_landmarks(graph, 3)):
        with pytest.raises(GraphError, match="the graph has none"):
            add()


@pytest.mark.parametrize("world", [manhattan, sphere])
def test_all_that_a_graph_has_moves_into_the_frame_of_the_fixes(world):
    truth = add_landmarks(perturb(world(100), [0.1] * (3 if world is manhattan else 6)), 10, seed=1)
    d = truth.dimension
    random = np.random.default_rng(1)
    on_pose = np.diag(random.uniform(1, 9, truth.dof))
    position = np.zeros_like(on_pose)
    position[:d, :d] = np.diag(random.uniform(1, 9, d))
    off = lie.retract(lie.identity(d), random.normal(size=(3, truth.dof)))
    at = np.tile(lie.identity(d), (3, 1))
    at[:, :d] = random.normal(size=(3, d))
    priors = [
        masat.pose_priors([1, 2, 3], off, on_pose, offset=off[0]),
        masat.pose_priors([4, 5, 6], at, position, offset=off[1]),
        masat.pose_priors(truth.point_ids[:3], at, position),
        masat.headings([7], [0.3], 0.1) if d == 2 else masat.altitudes([7], [3], 0.1),
    ]
    truth = truth.with_priors(priors)
    moved, is_bad = add_fixes(truth, 0.1, 0.0, frame=FRAMES[d])
    own = len(truth.priors)
    assert (len(is_bad), len(moved.priors)) == (own + 10, own + 10)
    assert_allclose(moved.chi2_per_prior[:own], truth.chi2_per_prior, rtol=1e-6)
    assert_allclose(moved.chi2_per_observation, truth.chi2_per_observation, rtol=1e-6)
    # Positions remain fixes along the axes of the world.
    assert_array_equal(moved.priors.measurements[3:9, d:], truth.priors.measurements[3:9, d:])


def test_noise_leaves_the_labels():
    truth = manhattan(50)
    labeled = replace(truth, labels=np.arange(len(truth.edges)))
    assert_array_equal(perturb(labeled, [0.1, 0.1, 0.1]).labels, labeled.labels)
