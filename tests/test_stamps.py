"""Stamps stay with their nodes, and poses between them lie on the way of a moving body."""

import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from masat import GraphError, PoseGraph, Result, lie, merge, optimize, read, solve, write
from masat.worlds import manhattan, perturb, sphere

NANOSECONDS = 1305031098665900000
EDGES, STEPS = [(0, 1), (1, 2), (2, 3)], [(1, 0, 0)] * 3
POSES = [(0, 0, 0), (1, 0, 0), (2, 0, 0), (3, 0, 0)]


def chain(stamps=(10.0, 11.0, 13.0, 14.5), **options):
    return PoseGraph.from_arrays(EDGES, STEPS, poses=POSES, stamps=stamps, **options)


def random_poses(rng, count, dimension):
    flat = rng.normal(size=(count, dimension))
    if dimension == 2:
        return np.column_stack([flat, rng.uniform(-np.pi, np.pi, count)])
    q = rng.normal(size=(count, 4))
    return np.hstack([flat, q / np.linalg.norm(q, axis=1, keepdims=True)])


def assert_same_poses(a, b, tolerance=1e-12):
    assert np.abs(lie.local(a, b)).max() < tolerance


def test_floating_point_stamps_are_seconds_and_integers_are_nanoseconds():
    assert chain().stamps.dtype == np.float64
    assert chain(np.float32([1, 2, 3, 4])).stamps.dtype == np.float64
    whole = chain(np.arange(4, dtype=np.uint64) + NANOSECONDS)
    assert whole.stamps.dtype == np.int64
    assert whole.stamps[3] == NANOSECONDS + 3
    assert PoseGraph.from_arrays(EDGES, STEPS).stamps is None


def test_stamps_are_copies_that_nobody_can_write():
    given = np.array([1.0, 2, 3, 4])
    graph = chain(given)
    given[0] = 7
    assert graph.stamps[0] == 1
    with pytest.raises(ValueError, match="read-only"):
        graph.stamps[0] = 7


def test_stamps_follow_the_order_of_the_ids():
    graph = PoseGraph.from_arrays(
        [(5, 2)], [(1, 0, 0)], ids=[5, 2, 9], stamps=[5, 2, 9], poses=POSES[:3]
    )
    assert graph.stamps.tolist() == graph.ids.tolist() == [2, 5, 9]


@pytest.mark.parametrize(
    ("stamps", "message"),
    [
        ([1.0, 2.0], r"stamps must have shape \(4,\), one for each node, got \(2,\)"),
        ([[1.0] * 4], r"got \(1, 4\)"),
        (7.0, r"got \(\)"),
        ([1, 2, np.nan, 4], "the stamp of node 2 is not finite"),
        ([1, 2, 3, np.inf], "the stamp of node 3 is not finite"),
        (["a"] * 4, "stamps must be numbers, got strings"),
        ([2**63] * 4, "stamps must be integers of at most 64 bits"),
        (np.array([1, 2, 3, 4], "M8[ns]"), "stamps must be numbers, got dates"),
    ],
)
def test_bad_stamps_are_refused(stamps, message):
    with pytest.raises(GraphError, match=message):
        chain(stamps)
    with pytest.raises(GraphError, match=message):
        chain().with_stamps(stamps)


def test_with_stamps_replaces_and_removes_them():
    assert chain().with_stamps([4, 3, 2, 1]).stamps.tolist() == [4, 3, 2, 1]
    assert chain().with_stamps(None).stamps is None


def test_edits_keep_the_stamp_of_each_node():
    graph = chain()
    assert graph.without_edges([0]).stamps is graph.stamps
    assert graph.with_fixed(0).stamps is graph.stamps
    assert graph.with_root(2).stamps is graph.stamps
    assert graph.with_poses(POSES).stamps is graph.stamps
    assert graph.without_nodes(1).stamps.tolist() == [10.0, 13.0, 14.5]
    assert graph.relabel({0: 7}).stamps.tolist() == [11.0, 13.0, 14.5, 10.0]
    assert graph.with_edges([(0, 2)], [(2, 0, 0)]).stamps.tolist() == graph.stamps.tolist()


def test_new_nodes_bring_their_stamps():
    longer = chain().with_edges(
        [(3, 9), (9, -1)], [(1, 0, 0)] * 2, ids=[9, -1], stamps=[15.0, 16.0]
    )
    assert longer.ids.tolist() == [-1, 0, 1, 2, 3, 9]
    assert longer.stamps.tolist() == [16.0, 10.0, 11.0, 13.0, 14.5, 15.0]


def test_new_nodes_have_stamps_if_and_only_if_the_graph_has():
    with pytest.raises(GraphError, match="its new node 4 needs one: give `stamps`"):
        chain().with_edges([(3, 4)], [(1, 0, 0)])
    with pytest.raises(GraphError, match="the graph has no stamps"):
        chain(None).with_edges([(3, 4)], [(1, 0, 0)], stamps=[1.0])
    with pytest.raises(GraphError, match=r"stamps must have shape \(1,\)"):
        chain().with_edges([(3, 4)], [(1, 0, 0)], stamps=[1.0, 2.0])
    with pytest.raises(GraphError, match=r"seconds .* nanoseconds .* cannot be joined"):
        chain().with_edges([(3, 4)], [(1, 0, 0)], stamps=[1])


def test_a_merged_graph_has_the_stamps_of_all():
    other = chain([1.0, 2.0, 3.0, 4.0])
    assert merge([chain(), other]).stamps.tolist() == [10, 11, 13, 14.5, 1, 2, 3, 4]
    assert merge([chain(), other], offsets=[10, 0]).stamps.tolist() == [
        1,
        2,
        3,
        4,
        10,
        11,
        13,
        14.5,
    ]
    lost = merge([chain(), chain(None)])
    assert lost.stamps is None
    assert "the merged graph has no stamps, since graph 1 has none" in lost.notes
    with pytest.raises(GraphError, match="cannot be joined"):
        merge([chain(), chain([1, 2, 3, 4])])


@pytest.mark.parametrize("robust", [False, True])
def test_a_solution_has_the_stamps_and_so_has_its_file(tmp_path, robust):
    truth = manhattan(100, 150, extent=6)
    graph = perturb(truth.with_stamps(np.arange(100) + NANOSECONDS), (0.05, 0.05, 0.02))
    result = solve(graph, robust=robust)
    result.save(tmp_path / "result.npz")
    again = Result.load(tmp_path / "result.npz").graph
    for stamps in (result.graph.stamps, optimize(truth.with_stamps(graph.stamps)).graph.stamps):
        assert_array_equal(stamps, graph.stamps)
    assert again.stamps.dtype == np.int64
    assert_array_equal(again.stamps, graph.stamps)
    write(result.graph, tmp_path / "map.g2o.gz")
    assert_array_equal(read(tmp_path / "map.g2o.gz").stamps, graph.stamps)
    solve(perturb(truth, (0.05,) * 3)).save(tmp_path / "result.npz")
    assert Result.load(tmp_path / "result.npz").graph.stamps is None


def test_a_pickle_has_the_stamps():
    again = pickle.loads(pickle.dumps(chain()))
    assert again.stamps.tolist() == chain().stamps.tolist()
    assert not again.stamps.flags.writeable


# --- pose_at ---


def test_a_pose_between_two_on_a_line_divides_it():
    graph = chain()
    assert_allclose(graph.pose_at(10.25), (0.25, 0, 0))
    assert_allclose(graph.pose_at(12), (1.5, 0, 0))
    assert graph.pose_at([[10.25, 12.0]]).shape == (1, 2, 3)
    assert graph.pose_at([]).shape == (0, 3)


def test_a_pose_between_two_on_a_circle_is_on_it():
    # A quarter of the unit circle around (0, 1), from its lowest to its rightmost point.
    a, b = (0, 0, 0), (1, 1, np.pi / 2)
    graph = PoseGraph.from_arrays([(0, 1)], [b], poses=[a, b], stamps=[0.0, 3.0])
    assert_allclose(graph.pose_at(1.0), (0.5, 1 - np.cos(np.pi / 6), np.pi / 6), atol=1e-15)


def test_at_a_stamp_the_pose_is_that_of_the_node():
    rng = np.random.default_rng(0)
    poses = random_poses(rng, 50, 3)
    graph = PoseGraph.from_arrays(
        np.empty((0, 2), int), np.empty((0, 7)), ids=range(50), poses=poses,
        stamps=rng.permutation(50) / 7,
    )  # fmt: skip
    assert_array_equal(graph.pose_at(graph.stamps), graph.poses)


def test_nanoseconds_are_interpolated_exactly():
    stamps = np.array([0, 1000, 2000, 3000]) + NANOSECONDS
    assert_allclose(chain(stamps).pose_at(NANOSECONDS + 1), (0.001, 0, 0), rtol=1e-12)
    extreme = chain([-(2**63), 2**63 - 1, 2**63 - 2, 0])
    assert_allclose(extreme.pose_at(-(2**62)), (1.5, 0, 0))


@pytest.mark.parametrize(
    ("graph", "arguments", "message"),
    [
        (chain(None), (1.0,), "the graph has no stamps"),
        (PoseGraph.from_arrays(EDGES, STEPS, stamps=[1, 2, 3, 4]), (1,), "the graph has no poses"),
        (chain(), (9.9,), "9.9 is not between the first stamp, 10.0, and the last, 14.5"),
        (chain(), ([11.0, 14.6],), "the time 14.6 is not between"),
        (chain(), (np.nan,), "the time nan is not between"),
        (chain(), ("noon",), "the time must be numbers, got strings"),
        (chain([1, 2, 3, 4]), (1.5,), r"stamps of the graph are in nanoseconds \(integers\)"),
        (chain([1.0, 2, 2, 3]), (1.5,), "the nodes 1 and 2 both have the stamp 2.0"),
    ],
)
def test_there_is_no_pose_at_such_a_time(graph, arguments, message):
    with pytest.raises(GraphError, match=message):
        graph.pose_at(*arguments)


def test_a_gap_is_refused_if_a_limit_is_given():
    graph = chain()
    assert_allclose(graph.pose_at(12.0, max_gap=2.0), (1.5, 0, 0))
    assert_allclose(graph.pose_at([11.0, 13.0], max_gap=0.1), [(1, 0, 0), (2, 0, 0)])
    message = "12.0 lies in a gap of 2 between node 1 at 11.0 and node 2 at 13.0"
    with pytest.raises(GraphError, match=message):
        graph.pose_at([10.5, 12.0], max_gap=1.9)


def test_the_nodes_of_one_robot_can_be_chosen():
    both = merge([chain(), chain([10.5, 11.5, 12.5, 13.5])])
    assert_allclose(both.pose_at(12.0, nodes=range(4)), (1.5, 0, 0))
    assert_allclose(both.pose_at(12.0, nodes=range(10**6, 10**6 + 4)), (1.5, 0, 0))
    with pytest.raises(
        GraphError, match=r"12\.8 is between the nodes 1000002 and 2, which no edges"
    ):
        both.pose_at(12.8)
    with pytest.raises(GraphError, match="`nodes` is empty"):
        both.pose_at(12.0, nodes=[])
    with pytest.raises(GraphError, match="no node 99"):
        both.pose_at(12.0, nodes=[99])


def test_components_share_a_frame_if_their_nodes_are_fixed():
    cut = chain().without_edges([1])
    with pytest.raises(GraphError, match=r"12.0 is between the nodes 1 and 2, which no edges join"):
        cut.pose_at(12.0)
    assert_allclose(cut.pose_at(10.5), (0.5, 0, 0))
    assert_allclose(cut.with_fixed([0, 3]).pose_at(12.0), (1.5, 0, 0))


# --- interpolation on the group ---


@given(st.integers(0, 2**32 - 1), st.sampled_from([2, 3]), st.floats(0, 1))
def test_interpolation_commutes_with_motions_on_both_sides(seed, dimension, fraction):
    rng = np.random.default_rng(seed)
    a, b, frame, sensor = random_poses(rng, 4, dimension)
    between = lie.interpolate(a, b, fraction)

    def moved(pose):
        return lie.compose(lie.compose(frame, pose), sensor)

    assert_same_poses(lie.interpolate(moved(a), moved(b), fraction), moved(between), 1e-7)


@given(st.integers(0, 2**32 - 1), st.sampled_from([2, 3]), st.integers(1, 12))
def test_equal_steps_lead_from_one_pose_to_the_other(seed, dimension, count):
    rng = np.random.default_rng(seed)
    a, b = random_poses(rng, 2, dimension)
    step = lie.between(a, lie.interpolate(a, b, 1 / count))
    pose = a
    for _ in range(count):
        pose = lie.compose(pose, step)
    assert_same_poses(pose, b, 1e-9)
    assert_same_poses(lie.interpolate(a, b, 0.0), a)
    assert_same_poses(lie.interpolate(a, b, 1.0), b)
    assert_same_poses(lie.interpolate(a, b, 0.3), lie.interpolate(b, a, 0.7), 1e-7)


def test_the_planar_group_is_interpolated_as_a_part_of_the_spatial_one():
    a, b = random_poses(np.random.default_rng(1), 2000, 2).reshape(2, 1000, 3)
    fraction = np.linspace(0, 1, 1000)
    flat = lie.interpolate(a, b, fraction)
    assert_same_poses(lie.to_3d(flat), lie.interpolate(lie.to_3d(a), lie.to_3d(b), fraction), 1e-10)


@pytest.mark.parametrize("angle", [0.0, 1e-300, 1e-12, 1e-8, 1e-4])
def test_small_turns_are_nearly_straight(angle):
    half = angle / 2
    for a, b in (
        ((0, 0, 0), (2, 1, angle)),
        ((0, 0, 0, 0, 0, 0, 1), (2, 1, 0, 0, 0, np.sin(half), np.cos(half))),
    ):
        middle = lie.interpolate(a, b, 0.5)
        assert_allclose(middle[:2], (1, 0.5), atol=angle)
        assert np.isfinite(middle).all()


def test_to_3d_leaves_poses_in_3d_and_turns_about_z():
    poses = sphere(50).poses
    assert lie.to_3d(poses) is poses
    assert_allclose(lie.to_3d((1, 2, np.pi / 2)), (1, 2, 0, 0, 0, 0.5**0.5, 0.5**0.5))
