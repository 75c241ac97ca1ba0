"""Position fixes in a frame of their own: the same map from any offset, and wrong ones."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from test_alignment import poses_at, random_pose

import masat
from masat import lie
from masat.worlds import WORLDS

GRAPHS = ["2d/input_M3500_g2o.g2o", "2d/kitti_00.g2o", "3d/sphere2500.g2o"]


def with_fixes(graph, poses, motion, *, wrong=0.0, seed=0):
    """The graph with a fix of half a meter on every 20th node, in a frame moved by a motion."""
    rng = np.random.default_rng(seed)
    d, nodes = graph.dimension, np.arange(0, len(graph.ids), 20)
    where = poses[nodes, :d] + rng.normal(size=(len(nodes), d)) * 0.5
    bad = rng.choice(len(nodes), round(wrong * len(nodes)), replace=False)
    far = rng.normal(size=(len(bad), d))
    where[bad] += 50 * far / np.linalg.norm(far, axis=1)[:, None]
    there = lie.compose(motion, poses_at(where))[:, :d]
    return graph.with_priors(masat.gps(graph.ids[nodes], there, 0.5)), bad


@pytest.mark.parametrize("name", GRAPHS)
def test_the_minimum_is_the_same_from_any_offset_and_heading(data_dir, name):
    graph = masat.read(data_dir / name)
    alone = masat.solve(graph)
    chi2 = []
    for seed in range(5):
        motion = random_pose(np.random.default_rng(seed), graph.dimension)
        fixed, _ = with_fixes(graph, alone.poses, motion)
        result = masat.solve(fixed)
        assert result.converged
        assert len(result.gauge) == 0
        assert_allclose(
            lie.compose(lie.inverse(motion), result.poses)[:, 0], alone.poses[:, 0], atol=2
        )
        chi2.append(result.chi2)
    assert_allclose(chi2, chi2[0], rtol=1e-9)


@pytest.mark.parametrize("method", sorted(masat.initializers.INITIALIZERS))
def test_every_initial_guess_is_aligned_with_its_priors(method):
    world = WORLDS["manhattan"](200, 300, seed=1)
    motion = np.array([500.0, -300, np.pi])
    there = lie.compose(motion, world.poses)
    if method == "given":
        world = world.with_poses(there)
    fixed = world.with_fixed([]).with_priors(masat.gps(world.ids[::7], there[::7, :2], 1.0))
    guess = masat.initialize(fixed, method)
    assert_allclose(guess.poses[:, :2], there[:, :2], atol=1e-6)
    assert guess.chi2 < 1e-9


def test_a_certificate_holds_with_fixes_as_without(data_dir):
    graph = masat.read(data_dir / GRAPHS[0])
    alone = masat.solve(graph, certify=True)
    assert alone.certificate.certified
    fixed, _ = with_fixes(graph, alone.poses, np.array([10.0, 20, 3]))
    result = masat.solve(fixed, certify=True)
    assert result.certificate.certified
    # Half the map turned by half a turn is no optimum.
    turned = result.poses.copy()
    half = turned[1750:]
    about = np.array([*turned[1750, :2], np.pi])
    back = lie.inverse(np.array([*turned[1750, :2], 0.0]))
    turned[1750:] = lie.compose(about, lie.compose(back, half))
    wrong = masat.certify(result.graph.with_poses(turned), search=False)
    assert not wrong.certified


def test_a_certificate_holds_far_from_the_origin(data_dir):
    # Rounding of coordinates of ten kilometers hides a gap of 2e-5 of chi2.
    graph = masat.read(data_dir / "2d/input_INTEL_g2o.g2o")
    fixed, _ = with_fixes(graph, masat.solve(graph).poses, np.array([1e4, -7e3, 2]))
    result = masat.solve(fixed, certify=True)
    assert result.certificate.certified
    turned = lie.compose(np.array([0.0, 0, 0.1]), result.poses)
    refuted = masat.certify(result.graph.with_poses(turned), search=False)
    assert refuted.status == "refuted"
    assert_allclose(refuted.better.poses, result.poses, atol=1e-4)


@pytest.mark.parametrize("d", [2, 3])
def test_an_unmeasured_rotation_of_half_a_turn_is_no_saddle(d):
    # All poses are half a turn from the axes of the world, which position fixes do not see.
    rng = np.random.default_rng(d)
    half = np.array([0, 0, np.pi]) if d == 2 else np.array([0, 0, 0, 0, 0, 1.0, 0])
    poses = np.tile(half, (30, 1))
    poses[:, :d] = np.cumsum(rng.normal(size=(30, d)), axis=0)
    edges = np.column_stack([np.arange(29), np.arange(1, 30)])
    z = lie.between(poses[:-1], poses[1:])
    z = lie.retract(z, rng.normal(size=(29, lie.DOF[d])) * 0.01)
    fixes = masat.gps(range(30), poses[:, :d] + rng.normal(size=(30, d)) * 0.1, 0.1)
    graph = masat.PoseGraph.from_arrays(edges, z, poses=poses, priors=fixes)
    there = lie.inverse(half)
    moved = masat.gps(
        range(30), lie.compose(there, poses_at(fixes.measurements[:, :d]))[:, :d], 0.1
    )
    same = graph.with_poses(lie.compose(there, poses)).with_priors(moved)
    first, second = (masat.optimize(g, "gauss_newton") for g in (graph, same))
    assert first.iterations == second.iterations
    assert_allclose(first.chi2, second.chi2, rtol=1e-9)


def test_a_third_of_wrong_fixes_has_no_weight_under_a_robust_loss(data_dir):
    graph = masat.read(data_dir / GRAPHS[0])
    alone = masat.solve(graph)
    fixed, bad = with_fixes(graph, alone.poses, np.array([300.0, 40, 2]), wrong=0.3)
    chain = np.ones(len(graph.edges), np.bool_)
    result = masat.solve(fixed, init="chordal", loss="gnc_tls", trusted=chain)
    # The map is as good as without the wrong fixes.
    good = np.delete(np.arange(len(fixed.priors)), bad)
    clean = masat.solve(fixed.with_priors(fixed.priors.rows(good)))
    assert_allclose(result.poses[:, :2], clean.poses[:, :2], atol=1.0)


def test_parts_that_only_fixes_tie_share_a_frame():
    corners = np.array([(0, 0), (10, 0), (10, 10), (0, 10)], float)
    edges = [(0, 1), (2, 3)]
    graph = masat.PoseGraph.from_arrays(
        edges, [(10, 0, 0), (10, 0, 0)], priors=masat.gps(range(4), corners, 0.1)
    )
    assert graph.components.tolist() == [0, 0, 0, 0]
    result = masat.solve(graph)
    assert result.chi2 < 1e-20
    assert_allclose(result.poses[:, :2], corners, atol=1e-9)


def test_a_full_prior_is_a_root():
    pose = (5, 6, 1.0)
    graph = masat.PoseGraph.from_arrays(
        [(0, 1)], [(1, 0, 0)], priors=masat.pose_priors([1], [pose])
    )
    for method in ("odometry", "masat", "chordal", "toro"):
        assert_allclose(masat.solve(graph, init=method).poses[1], pose, atol=1e-9)


@pytest.mark.parametrize("d", [2, 3])
def test_landmarks_alone_join_the_parts_of_a_map(d):
    # Two robots see the same four landmarks; no edge joins them.
    rng = np.random.default_rng(d)
    poses = np.array([random_pose(rng, d, 3.0) for _ in range(6)])
    points = rng.normal(size=(4, d)) * 5
    edges = [(0, 1), (1, 2), (3, 4), (4, 5)]
    z = np.array([lie.between(poses[a], poses[b]) for a, b in edges])
    seen = [(k, 100 + j) for k in range(6) for j in range(4)]
    where = [lie.between(poses[k], poses_at(points)[j - 100])[:d] for k, j in seen]
    graph = masat.PoseGraph.from_arrays(
        edges, z, landmarks=masat.landmarks(seen, where), poses=poses, fixed=[0]
    )
    result = masat.solve(graph)
    assert result.chi2 < 1e-18
    assert_allclose(result.graph.points, points, atol=1e-8)
    assert_allclose(lie.local(result.poses, poses), 0, atol=1e-8)


@pytest.mark.parametrize("d", [2, 3])
def test_certificates_hold_with_lever_arms(d):
    world = WORLDS["manhattan" if d == 2 else "sphere"](300, 900, seed=1)
    noisy = masat.worlds.perturb(world, (0.05, 0.05, 0.05) if d == 2 else (0.05, 0.05), seed=2)
    antenna = np.array([1.5, -0.5, 2.0])[:d]
    motion = random_pose(np.random.default_rng(3), d)
    at = np.zeros((300, d)) + antenna
    where = lie.compose(motion, lie.compose(world.poses, poses_at(at)))[::10, :d]
    where += np.random.default_rng(4).normal(size=where.shape) * 0.3
    fixes = masat.gps(world.ids[::10], where, 0.3, lever_arm=antenna)
    result = masat.solve(noisy.with_fixed([]).with_priors(fixes), certify=True)
    assert result.certificate.certified
    # Half of the map turned is another minimum or none, and never certified.
    turned = result.poses.copy()
    about = np.zeros((1, turned.shape[1]))
    about[0, -1] = np.pi if d == 2 else 0.0
    if d == 3:
        about[0, 4] = 1.0
    turned[150:] = lie.compose(turned[150:], np.tile(about, (150, 1)))
    assert not masat.certify(result.graph.with_poses(turned), search=False).certified
    # Without the lever arm the same fixes make another map.
    plain = masat.gps(world.ids[::10], where, 0.3)
    assert masat.solve(noisy.with_fixed([]).with_priors(plain)).chi2 > result.chi2


def test_a_single_wrong_fix_is_named():
    world = WORLDS["manhattan"](400, 1200, seed=3)
    noisy = masat.worlds.perturb(world, (0.02, 0.02, 0.02), seed=1)
    where = world.poses[::20, :2] + np.random.default_rng(0).normal(size=(20, 2)) * 0.1
    good = noisy.with_fixed([]).with_priors(masat.gps(world.ids[::20], where, 0.1))
    assert masat.solve(good).graph.notes == good.notes
    where[7] += 10.0
    bad = good.with_priors(masat.gps(world.ids[::20], where, 0.1))
    with pytest.warns(masat.MasatWarning, match="some measurements are wrong"):
        notes = masat.solve(bad).graph.notes
    assert f"(chi2 of the worst: the prior of {world.ids[140]}" in notes[-1]


def test_a_loss_tells_which_fixes_and_observations_it_believes(tmp_path):
    world = WORLDS["manhattan"](400, 1200, seed=3)
    seen = masat.worlds.add_landmarks(world, 20, sigma=0.05, seed=2)
    noisy = masat.worlds.perturb(seen, (0.02, 0.02, 0.02), seed=1)
    where = world.poses[::20, :2].copy()
    where[7] += 10.0
    graph = noisy.with_fixed([]).with_priors(masat.gps(world.ids[::20], where, 0.1))
    result = masat.solve(graph, loss="geman_mcclure")
    assert result.weights.shape == (len(graph.edges),)
    assert np.flatnonzero(result.prior_weights < 0.1).tolist() == [7]
    assert result.observation_weights.shape == (len(seen.landmarks.observations),)
    assert result.observation_weights.min() > 0.2
    result.save(tmp_path / "result.npz")
    again = type(result).load(tmp_path / "result.npz")
    assert (again.prior_weights == result.prior_weights).all()
    assert (again.observation_weights == result.observation_weights).all()


@pytest.mark.filterwarnings("ignore:.*seen only by 84 altitudes:masat.MasatWarning")
def test_altitudes_level_a_map_that_lies_askew(data_dir):
    graph = masat.read(data_dir / "3d/parking-garage.g2o")
    alone = masat.solve(graph)
    ids = graph.ids[::20]
    noise = np.random.default_rng(1).normal(size=len(ids)) * 0.5
    for seed in (3, 5):
        there = lie.compose(random_pose(np.random.default_rng(seed), 3), alone.poses)
        leveled = graph.with_fixed([]).with_priors(
            masat.altitudes(ids, there[::20, 2] + noise, 0.5)
        )
        result = masat.solve(leveled)
        expected = masat.solve(leveled.with_poses(there), init="given")
        assert result.chi2 <= expected.chi2 * (1 + 1e-6)
