"""Priors and landmarks: what they hold, what they cost, and that one solver serves all."""

import warnings

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import masat
from masat import GraphError, InformationError, MasatError, PoseGraph, lie
from masat.assembly import assemble
from masat.optimizers.equations import normal_equations

SQUARE = [(0, 1), (1, 2), (2, 3), (3, 0)]
QUARTER = {2: (1, 0, np.pi / 2), 3: (1, 0, 0, 0, 0, np.sin(np.pi / 4), np.cos(np.pi / 4))}


def square(d=2, **more):
    return PoseGraph.from_arrays(SQUARE, [QUARTER[d]] * 4, **more)


def random_poses(rng, n, d, reach=3.0):
    t = rng.normal(size=(n, d)) * reach
    if d == 2:
        return np.column_stack([t, rng.uniform(-np.pi, np.pi, n)])
    q = rng.normal(size=(n, 4))
    return np.column_stack([t, q / np.linalg.norm(q, axis=1)[:, None]])


def random_information(rng, n, d):
    a = rng.normal(size=(n, d, d + 2))
    return a @ a.transpose(0, 2, 1)


def graph_of_everything(d, seed=0, offset=True, ranges=True):
    """A graph with edges, all kinds of priors and of landmarks, and random poses of all."""
    rng = np.random.default_rng(seed)
    dof = lie.DOF[d]
    partial = random_information(rng, 3, dof)
    partial[0, d:] = partial[0, :, d:] = 0
    partial[1, :d] = partial[1, :, :d] = 0
    offsets = random_poses(rng, 3, d) if offset else None
    priors = masat.pose_priors([0, 1, 3], random_poses(rng, 3, d), partial, offset=offsets)
    priors += masat.gps([50, 2], rng.normal(size=(2, d)), 0.3)
    seen = masat.landmarks(
        [(0, 50), (1, 50), (2, 51), (3, 50)],
        rng.normal(size=(4, d)),
        random_information(rng, 4, d),
        positions=rng.normal(size=(2, d)),
    )
    if ranges:
        directions = rng.uniform(-1.5, 1.5, size=(4, d - 1))
        open_ = random_information(rng, 4, d)
        open_[1, 0] = open_[1, :, 0] = 0
        open_[2, 1:] = open_[2, :, 1:] = 0
        seen += masat.landmarks(
            [(0, 50), (1, 51), (3, 52), (2, 52)],
            np.column_stack([rng.uniform(0.5, 4, 4), directions]),
            open_,
            ids=[50, 51, 52],
            range_bearing=True,
        )
        seen = seen.with_positions(rng.normal(size=(3, d)))
    return PoseGraph.from_arrays(
        SQUARE,
        random_poses(rng, 4, d),
        random_information(rng, 4, dof),
        poses=random_poses(rng, 4, d),
        priors=priors,
        landmarks=seen,
    )


def test_priors_of_each_kind_hold_what_was_measured():
    fixes = masat.gps([3, 5], [(1, 2), (3, 4)], [0.5, 0.25])
    assert_array_equal(fixes.measurements, [[1, 2, 0], [3, 4, 0]])
    assert_array_equal(fixes.information, [np.diag([4.0, 16, 0])] * 2)
    turned = masat.headings([3], [0.5], 0.1)
    assert_array_equal(turned.measurements, [[0, 0, 0.5]])
    assert_allclose(turned.information, [np.diag([0, 0, 100])])
    high = masat.altitudes([3], [7], 0.5)
    assert_array_equal(high.measurements, [[0, 0, 7, 0, 0, 0, 1]])
    assert_array_equal(high.information, [np.diag([0, 0, 4.0, 0, 0, 0])])
    both = fixes + turned
    assert_array_equal(both.ids, [3, 5, 3])
    with pytest.raises(ValueError, match="read-only"):
        both.information[0] = 0


BAD_PRIORS = [
    (lambda: masat.gps([0], [(0, 0)], -1), GraphError, "sigma of node 0 must be positive"),
    (lambda: masat.gps([0, 1], [(0, 0)], 1), GraphError, r"positions must have shape \(2, 2\)"),
    (lambda: masat.gps([4], [(0, np.nan)], 1), GraphError, "prior of node 4 is not finite"),
    (lambda: masat.gps([0], [(0, 0)], 1, lever_arm=(1,)), GraphError, "lever_arm must have shape"),
    (lambda: masat.headings([0], [(0, 1)], 1), GraphError, "angles must have shape"),
    (lambda: masat.pose_priors([0], [(0, 0, 0)], -np.eye(3)), InformationError, "prior of node 0"),
    (lambda: masat.pose_priors([0], [(0, 0, 0)], np.zeros((3, 3))), InformationError, "zero"),
    (lambda: masat.gps([0], [(0, 0)], 1) + masat.altitudes([0], [1], 1), GraphError, "2D and in"),
    (lambda: square(priors=masat.gps([9], [(0, 0)], 1), ids=range(4)), GraphError, "node 9"),
    (lambda: square(priors=masat.altitudes([0], [1], 1)), GraphError, "priors are in 3D"),
    (lambda: square(priors=[np.eye(3)]), GraphError, "made by masat.gps"),
]


@pytest.mark.parametrize(("make", "error", "message"), BAD_PRIORS)
def test_bad_priors_are_one_clear_error(make, error, message):
    with pytest.raises(error, match=message):
        make()


BAD_LANDMARKS = [
    ([(0, 9)], [(1, 1, 1)], {}, "landmarks are in 3D"),
    ([(0, 3)], [(1, 1)], {}, "the id 3 is that of a pose and of a landmark"),
    ([(8, 9)], [(1, 1)], {}, r"observation 0 \(8 -> 9\) names pose 8"),
    ([(0, 9)], [(1, np.inf)], {}, r"observation 0 \(0 -> 9\) is not finite"),
    ([(0, 9)], [(1, 1)], {"ids": [8]}, "observation 0 .* names no landmark"),
    ([(0, 9)], [(1, 1)], {"positions": [(1, 1), (2, 2)]}, "positions of landmarks must have"),
    ([(0, 9)], [(1, 1)], {"positions": [(1, np.nan)]}, "position of landmark 9 is not finite"),
    ([(0, 9)], [(1, 1)], {"information": -np.eye(2)}, "first that of observation 0"),
]


@pytest.mark.parametrize(("pairs", "z", "more", "message"), BAD_LANDMARKS)
def test_bad_landmarks_are_one_clear_error(pairs, z, more, message):
    with pytest.raises(GraphError, match=message):
        square(landmarks=masat.landmarks(pairs, z, **more), ids=range(4))


def test_a_prior_on_a_landmark_is_of_its_position_alone():
    seen = masat.landmarks([(0, 9)], [(1, 1)])
    assert len(square(landmarks=seen, priors=masat.gps([9], [(2, 2)], 1)).priors) == 1
    with pytest.raises(GraphError, match="landmark 9 measures a rotation"):
        square(landmarks=seen, priors=masat.headings([9], [0], 1))


def test_the_cost_of_a_prior_and_of_an_observation_by_hand():
    graph = PoseGraph.from_arrays(
        [(0, 1)],
        [(1, 0, 0)],
        poses=[(0, 0, 0), (1, 0, np.pi / 2)],
        priors=masat.gps([1], [(3, 4)], [1, 0.5]) + masat.headings([1], [0], 0.5),
        landmarks=masat.landmarks([(1, 9)], [(1, 0)], np.diag([1.0, 4]), positions=[(0, 2)]),
    )
    # (1, 0) - (3, 4) = (-2, -4), with 1 and 4; a quarter turn with 4.
    assert_allclose(graph.chi2_per_prior, [4 + 16 * 4, 4 * (np.pi / 2) ** 2])
    # The landmark lies at (2, 1) in the frame of node 1: 1 and 1 off, with 1 and 4.
    assert_allclose(graph.chi2_per_observation, [1 + 4])
    assert_allclose(graph.chi2, graph.chi2_per_prior.sum() + 5 + (np.pi / 2) ** 2)


def test_a_lever_arm_is_where_the_antenna_is():
    # The antenna one meter ahead of a robot that looks along y stands at (0, 1).
    graph = PoseGraph.from_arrays(
        [],
        np.empty((0, 3)),
        ids=[0],
        poses=[(0, 0, np.pi / 2)],
        priors=masat.gps([0], [(0, 1)], 1, lever_arm=(1, 0)),
    )
    assert graph.chi2 < 1e-30


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("offset", [False, True])
@pytest.mark.parametrize("ranges", [False, True])
def test_the_assembled_graph_costs_the_same(d, offset, ranges):
    graph = graph_of_everything(d, offset=offset, ranges=ranges)
    assembly = assemble(graph)
    assert_allclose(assembly.graph.chi2, graph.chi2, rtol=1e-12)
    back = assembly.disassembled(assembly.graph.poses)
    assert_array_equal(back.poses, graph.poses)
    assert_array_equal(back.points, graph.points)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("offset", [False, True])
def test_gradients_are_those_of_finite_differences(d, offset):
    graph = assemble(graph_of_everything(d, offset=offset)).graph
    equations = normal_equations(graph)
    equations.linearize(graph.poses)
    gradient = -2 * equations.rhs()
    step = 1e-6
    for k in range(len(gradient)):
        ends = []
        for sign in (1, -1):
            move = np.zeros(len(gradient))
            move[k] = sign * step
            ends.append(equations.chi2(equations.retract(graph.poses, move)))
        assert_allclose(gradient[k], (ends[0] - ends[1]) / (2 * step), rtol=1e-5, atol=1e-4)


@pytest.mark.parametrize("d", [2, 3])
def test_jacobians_of_an_offset_are_those_of_finite_differences(d):
    # H of one prior is J' W J: with W = I the columns of J are the derivatives of the residual.
    rng = np.random.default_rng(1)
    pose, offset = random_poses(rng, 2, d)
    dof = lie.DOF[d]
    # Near the measurement, where the second derivatives of the residual do not matter.
    z = lie.compose(pose, offset)
    graph = PoseGraph.from_arrays(
        [],
        np.empty((0, len(pose))),
        ids=[0],
        poses=[pose],
        priors=masat.pose_priors([0], [z], offset=offset),
    )
    equations = normal_equations(assemble(graph).graph)
    equations.linearize(assemble(graph).graph.poses)
    h = np.array([equations.multiply(row) for row in np.eye(dof)])
    step = 1e-6
    jacobian = np.array(
        [
            lie.local(z, lie.compose(lie.retract(pose, sign), offset)) / step
            for sign in step * np.eye(dof)
        ]
    ).T
    assert_allclose(h, jacobian.T @ jacobian, atol=1e-4)


@pytest.mark.parametrize("d", [2, 3])
def test_the_rotation_of_a_landmark_stays_where_it_is(d):
    result = masat.optimize(graph_of_everything(d), max_iterations=10)
    assembly = assemble(result.graph)
    assert_allclose(assembly.graph.chi2_per_edge[assembly.measured :], 0, atol=1e-20)


def test_a_graph_without_any_is_solved_as_before():
    graph = square(poses=[(0, 0, 0), (1.1, 0, 1.5), (1, 1, 3.1), (0, 1, -1.5)])
    assert graph.priors is None
    assert graph.landmarks is None
    assert len(graph.point_ids) == 0
    assert graph.points is None
    assert graph.gauge is graph.structure.gauge
    assert graph.components is graph.structure.components
    assert type(masat.optimize(graph).graph) is PoseGraph


def test_edits_and_merges_carry_priors_and_landmarks():
    graph = graph_of_everything(2)
    assert_allclose(graph.relabel({0: 100, 2: -7}).chi2, graph.chi2)
    less = graph.without_nodes(1)
    assert_array_equal(less.priors.ids, [0, 3, 50, 2])
    kept = [(0, 50), (2, 51), (3, 50), (0, 50), (3, 52), (2, 52)]
    assert_array_equal(less.landmarks.observations, kept)
    assert_array_equal(less.landmarks.range_bearing, [False] * 3 + [True] * 3)
    two = masat.merge([graph, graph])
    assert_allclose(two.chi2, 2 * graph.chi2)
    assert_array_equal(two.point_ids, [50, 51, 52, 1_000_050, 1_000_051, 1_000_052])
    with pytest.raises(GraphError, match="the id 50 is that of a landmark"):
        graph.with_edges([(0, 50)], [(1, 0, 0)])


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize(
    ("to", "new"),
    [
        (7, lambda k: k + 7),
        (lambda k: -k, lambda k: -k),
        ({50: 3, 3: 50}, lambda k: {50: 3, 3: 50}.get(k, k)),
        ({k: 100 - k for k in range(4)}, lambda k: 100 - k if k < 4 else k),
    ],
)
def test_relabelling_renames_poses_and_landmarks_alike(d, to, new):
    graph = graph_of_everything(d)
    other = graph.relabel(to)
    assert other.ids.tolist() == sorted(new(k) for k in graph.ids.tolist())
    assert other.point_ids.tolist() == sorted(new(k) for k in graph.point_ids.tolist())
    assert other.priors.ids.tolist() == [new(k) for k in graph.priors.ids.tolist()]
    where = dict(zip(other.point_ids.tolist(), other.points.tolist(), strict=True))
    assert [where[new(k)] for k in graph.point_ids.tolist()] == graph.points.tolist()
    for old, same in zip(costs(graph), costs(other), strict=True):
        assert_array_equal(old, same)


@pytest.mark.parametrize(
    ("to", "message"),
    [
        ({0: 50}, "the node and the landmark 0 and 50 would both get the id 50"),
        ({50: 2}, "the node and the landmark 2 and 50 would both get the id 2"),
        ({50: 51}, "the landmarks 50 and 51 would both get the id 51"),
        ({0: 1}, "the nodes 0 and 1 would both get the id 1"),
        ({60: 1}, "the graph has no node 60"),
    ],
)
def test_no_two_nodes_or_landmarks_get_one_id(to, message):
    with pytest.raises(GraphError, match=message):
        graph_of_everything(2).relabel(to)


def costs(graph):
    return graph.chi2_per_edge, graph.chi2_per_prior, graph.chi2_per_observation


@pytest.mark.parametrize("d", [2, 3])
def test_a_saved_result_keeps_them(d, tmp_path):
    result = masat.optimize(graph_of_everything(d))
    result.save(tmp_path / "map.npz")
    again = masat.Result.load(tmp_path / "map.npz").graph
    assert again.chi2 == result.graph.chi2
    assert_array_equal(again.points, result.graph.points)


def test_degrees_of_freedom_count_what_was_measured():
    graph = square(
        priors=masat.gps([0, 1], [(0, 0), (1, 0)], 0.1),
        landmarks=masat.landmarks([(0, 9), (1, 9)], [(1, 1), (1, 0)]),
    )
    result = masat.solve(graph)
    assert result.degrees_of_freedom == 4 * 3 + 2 * 2 + 2 * 2 - 4 * 3 - 2
    assert masat.diagnose(graph).degrees_of_freedom == 6


@pytest.mark.parametrize(
    ("more", "extra"),
    [
        # One fix is met exactly: the heading stays open.
        ({"priors": masat.gps([0], [(0, 0)], 0.1)}, 0),
        ({"priors": masat.headings([0], [0], 0.1)}, 0),
        ({"priors": masat.gps([0], [(0, 0)], 0.1) + masat.headings([1], [0], 0.1)}, 0),
        ({"priors": masat.gps([0, 2], [(0, 0), (1, 1)], 0.1)}, 1),
        # No direction is too little informed beside others: units differ.
        ({"priors": masat.pose_priors([0, 2], [(0, 0, 0)] * 2, np.diag([1e13, 1e-4, 0]))}, 1),
        # A landmark that nothing measures is no unknown, nor is what one ray leaves open.
        ({"landmarks": masat.landmarks([(0, 9)], [(1, 1)], ids=[8, 9])}, 0),
        ({"landmarks": masat.landmarks([(0, 9)], [(1, 0)], np.diag([0, 1.0]))}, 0),
        ({"landmarks": masat.landmarks([(0, 9), (2, 9)], [(1, 1), (0, 0)])}, 2),
    ],
)
def test_degrees_of_freedom_leave_out_what_nothing_determines(more, extra):
    graph = square(**more)
    # Four edges of three numbers and three optimized poses: three numbers are left over.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", masat.MasatWarning)
        result = masat.solve(graph)
    assert result.degrees_of_freedom == 3 + extra


def test_degrees_of_freedom_without_poses_leave_out_landmarks_that_nothing_measures():
    seen = masat.landmarks([(0, 9)], [(1, 1)], ids=[7, 8, 9])
    graph = square(landmarks=seen, priors=masat.gps([8], [(0, 0)], 1))
    assert masat.diagnose(graph.with_priors(None)).degrees_of_freedom == 3
    assert masat.diagnose(square(landmarks=seen)).degrees_of_freedom == 3


def test_degrees_of_freedom_of_numbers_that_overflow():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for scale, far in ((1.0, 1.0), (1e308, 1e150)):
            graph = PoseGraph.from_arrays(
                [(0, 1)],
                [(1, 0, 0)],
                scale * np.eye(3),
                poses=[(0, 0, 0), (far, 0, 0)],
                priors=masat.gps([0, 1], [(0, 0), (1, 0)], 1),
            )
            assert masat.diagnose(graph).degrees_of_freedom == 1


def test_covariances_of_poses_and_landmarks_by_hand():
    graph = PoseGraph.from_arrays(
        [],
        np.empty((0, 3)),
        ids=[0],
        poses=[(0, 0, 0)],
        priors=masat.pose_priors([0], [(0, 0, 0)], np.diag([4.0, 16, 25])),
        landmarks=masat.landmarks([(0, 9)], [(10, 0)], np.eye(2), positions=[(10, 0)]),
    )
    assert_allclose(masat.covariances(graph), [np.diag([0.25, 0.0625, 0.04])], atol=1e-12)
    # Across its ray the landmark has the heading's part, ten meters away.
    expected = np.diag([0.25 + 1, 0.0625 + 100 * 0.04 + 1])
    assert_allclose(masat.landmark_covariances(graph), [expected], atol=1e-12)
    with pytest.raises(GraphError, match="no landmark 0"):
        masat.landmark_covariances(graph, [0])


def test_positions_on_the_earth_need_a_package_or_are_near_their_origin():
    try:
        import pymap3d  # noqa: F401
    except ImportError:
        with pytest.raises(MasatError, match=r"masat\[gps\]"):
            masat.east_north_up([48.0], [11.0])
        return
    there = masat.east_north_up([48.0, 48.0, 48.001], [11.0, 11.001, 11.0], [500, 500, 510])
    assert_allclose(there[0], 0, atol=1e-9)
    assert_allclose(there[1], [74.6, 0, 0], atol=0.1)
    assert_allclose(there[2], [0, 111.2, 10], atol=0.1)


def test_what_is_no_position_on_the_earth_is_refused():
    with pytest.raises(GraphError, match="position 1 is not on the Earth"):
        masat.east_north_up([0, 91], [0, 0])


@pytest.mark.parametrize(
    ("matrix", "fine"),
    [
        (np.diag([1.0, 1, 0]), True),
        (np.diag([0, 0, 3.0]), True),
        (np.array([[1.0, 1, 0], [1, 1, 0], [0, 0, 1]]), True),
        (np.diag([1e300, 1e-300, 0]), True),
        (np.array([[0, 1, 0], [1, 0, 0], [0, 0, 1.0]]), False),
        (np.diag([1e308, 1, -1]), False),
        (np.array([[1.0, 1 + 1e-9, 0], [1 + 1e-9, 1, 0], [0, 0, 1]]), False),
        (np.zeros((3, 3)), False),
    ],
)
def test_information_may_be_semidefinite_but_not_indefinite_or_zero(matrix, fine):
    if fine:
        graph = PoseGraph.from_arrays([(0, 1)], [(1, 0, 0)], matrix)
        assert graph.has_partial_edges or np.linalg.cond(matrix) > 1e20
        return
    with pytest.raises(InformationError, match="are zero or not positive semidefinite"):
        PoseGraph.from_arrays([(0, 1)], [(1, 0, 0)], matrix)


@pytest.mark.parametrize("left", [None, masat.landmarks([(0, 8)], [(1, 1)])])
def test_a_landmark_with_a_prior_cannot_be_taken_out_alone(left):
    graph = PoseGraph.from_arrays(
        [(0, 1), (1, 20)],
        [(1, 0, 0)] * 2,
        priors=masat.gps([9, 0, 20], [(50, 70), (0, 0), (2, 0)], 0.1),
        landmarks=masat.landmarks([(0, 9)], [(1, 1)]),
    )
    with pytest.raises(GraphError, match="a prior names node 9, which is not in the graph"):
        graph.with_landmarks(left)
    alone = graph.with_priors(graph.priors.rows(graph.priors.ids != 9)).with_landmarks(left)
    assert_allclose(masat.solve(alone).poses[:, :2], [(0, 0), (1, 0), (2, 0)], atol=1e-6)


def two_squares(priors=None, landmarks=None, fixed=()):
    """Nodes 0 to 3 and 10 to 13, each a square in a frame of its own."""
    edges = [*SQUARE, *((a + 10, b + 10) for a, b in SQUARE)]
    return PoseGraph.from_arrays(
        edges, [QUARTER[2]] * 8, priors=priors, landmarks=landmarks, fixed=fixed
    )


@pytest.mark.parametrize("root_of", [PoseGraph.with_root, lambda g, k: masat.solve(g, root=k)])
def test_a_root_that_priors_place_is_refused(root_of):
    graph = two_squares(masat.gps([0, 2], [(5, 5), (6, 6)], 0.1))
    with pytest.raises(GraphError, match="the root 1 cannot be chosen: priors place"):
        root_of(graph, 1)
    assert graph.with_root(12).gauge.tolist() == [12]
    fixed = graph.with_fixed(3)
    assert fixed.with_root(3).gauge.tolist() == fixed.gauge.tolist() == [3, 10]


def test_a_root_of_parts_that_landmarks_join_is_that_of_all():
    seen = masat.landmarks([(0, 50), (10, 50)], [(1, 1), (1, 0)])
    graph = two_squares(landmarks=seen)
    assert graph.gauge.tolist() == [0]
    assert graph.with_root(1).with_root(12).gauge.tolist() == [12]
    with pytest.raises(GraphError, match="the roots 1 and 12 are in one component"):
        graph.with_root([1, 12])
    with pytest.raises(GraphError, match="the root 12 is not fixed but its component holds fixed"):
        two_squares(landmarks=seen, fixed=0).with_root(12)
    with pytest.raises(GraphError, match="the graph has no node 50"):
        graph.with_root(50)


def test_components_are_in_the_order_of_their_poses_whatever_the_ids_of_landmarks():
    graph = two_squares(landmarks=masat.landmarks([(10, -5)], [(1, 1)]))
    assert graph.components.tolist() == [0] * 4 + [1] * 4


@pytest.mark.filterwarnings("error")
def test_no_id_is_left_for_the_world_beyond_the_largest():
    last = 2**63 - 1
    graph = PoseGraph.from_arrays([(0, last)], [(1, 0, 0)], priors=masat.gps([0], [(0, 0)], 1))
    with pytest.raises(GraphError, match=f"the id {last} is the largest there is"):
        masat.solve(graph)
