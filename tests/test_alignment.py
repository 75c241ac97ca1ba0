"""The rigid motion of a map onto what is known of it: exact, and robust against wrong matches."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from masat import _core, lie
from masat.alignment import Matches, leveling_motion, rigid_motion


def random_pose(rng, d, reach=1e4):
    if d == 2:
        return np.array([*rng.normal(size=2) * reach, rng.uniform(-np.pi, np.pi)])
    q = rng.normal(size=4)
    return np.array([*rng.normal(size=3) * reach, *q / np.linalg.norm(q)])


def poses_at(points):
    poses = np.tile(lie.identity(points.shape[1]), (len(points), 1))
    poses[:, : points.shape[1]] = points
    return poses


def matches_of(points, targets, rotations=(), turned=()):
    d = points.shape[1]
    return Matches(
        points,
        targets,
        np.ones(len(points)),
        np.reshape(rotations, (-1, d, d)),
        np.reshape(turned, (-1, d, d)),
        np.ones(len(rotations)),
    )


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("seed", range(10))
def test_any_motion_is_found_although_a_third_of_the_matches_is_wrong(d, seed):
    rng = np.random.default_rng(seed)
    motion = random_pose(rng, d)
    points = rng.normal(size=(60, d)) * 100
    targets = lie.compose(motion, poses_at(points))[:, :d]
    targets += rng.normal(size=targets.shape) * 0.01
    targets[rng.choice(60, 19, replace=False)] += rng.normal(size=(19, d)) * 10.0 ** rng.integers(5)
    found = rigid_motion(matches_of(points, targets))
    assert np.abs(lie.local(motion, found)[:d]).max() < 0.05
    assert np.abs(lie.local(motion, found)[d:]).max() < 1e-3


def test_many_matches_of_which_a_third_lies_in_another_frame():
    rng = np.random.default_rng(0)
    motion, other = random_pose(rng, 2), random_pose(rng, 2)
    points = rng.normal(size=(900, 2)) * 100
    targets = lie.compose(motion, poses_at(points))[:, :2]
    targets[::3] = lie.compose(other, poses_at(points[::3]))[:, :2]
    targets += rng.normal(size=targets.shape) * 0.01
    assert_allclose(lie.local(motion, rigid_motion(matches_of(points, targets))), 0, atol=0.01)


def test_half_a_turn_between_the_frames_is_no_special_case():
    points = np.array([[0.0, 0], [1, 0], [0, 2], [5, 1]])
    found = rigid_motion(matches_of(points, -points + [7, 3]))
    assert_allclose(np.abs(found), [7, 3, np.pi], atol=1e-9)


@pytest.mark.parametrize("d", [2, 3])
def test_rotations_count_where_positions_leave_them_open(d):
    rng = np.random.default_rng(3)
    motion = random_pose(rng, d)
    own = np.array([random_pose(rng, d, 1.0)])
    there = lie.compose(motion, own)
    found = rigid_motion(
        matches_of(
            own[:, :d],
            there[:, :d],
            _core.rotation_matrices(own),
            _core.rotation_matrices(there),
        )
    )
    assert_allclose(lie.local(motion, found), 0, atol=1e-8)


def test_one_position_moves_the_map_without_rotating_it():
    found = rigid_motion(matches_of(np.array([[1.0, 2]]), np.array([[5.0, 5]])))
    assert_allclose(found, [4, 3, 0], atol=1e-12)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("wrong", [0.0, 0.3])
def test_heights_level_a_map(d, wrong):
    rng = np.random.default_rng(5)
    positions = rng.normal(size=(40, d)) * 20
    motion = random_pose(rng, d)
    axis = np.eye(d)[d - 1]
    heights = lie.compose(motion, poses_at(positions))[:, d - 1]
    bad = rng.choice(40, round(wrong * 40), replace=False)
    heights[bad] += rng.normal(size=len(bad)) * 50
    pose = leveling_motion(positions, axis, heights, np.ones(40))
    after = lie.compose(pose, poses_at(positions))[:, d - 1]
    good = np.setdiff1d(np.arange(40), bad)
    assert_allclose(after[good], heights[good], atol=1e-6)
    # The smallest rotation does not turn about the axis, and nothing moves across it.
    assert_allclose(pose[: d - 1], 0, atol=1e-9)
    if d == 3:
        assert abs(pose[5]) < 1e-9


def test_heights_of_a_level_map_leave_it_level():
    flat = np.column_stack([np.arange(6.0), np.arange(6.0) ** 2, np.zeros(6)])
    pose = leveling_motion(flat, np.array([0.0, 0, 1]), np.full(6, 3.0), np.ones(6))
    assert_allclose(pose, [0, 0, 3, 0, 0, 0, 1], atol=1e-6)
    # One height tells the level alone.
    pose = leveling_motion(flat[:1], np.array([0.0, 0, 1]), np.full(1, 3.0), np.ones(1))
    assert_allclose(pose, [0, 0, 3, 0, 0, 0, 1], atol=1e-6)
