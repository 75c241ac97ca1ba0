"""Ranges and bearings of landmarks: residuals, initial guesses, minima, and what is said."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import masat
from masat import FormatError, GraphError, MasatWarning, OptimizationError, PoseGraph, _core
from masat.initializers import INITIALIZERS
from masat.residuals import directions
from masat.worlds import add_landmarks, manhattan, perturb, sphere

STEPS = {2: [(1, 0, 0)] * 3, 3: [(1, 0, 0, 0, 0, 0, 1)] * 3}


def straight(d=2, **more):
    """Four poses along the x axis."""
    return PoseGraph.from_arrays([(0, 1), (1, 2), (2, 3)], STEPS[d], **more)


def seen_from(ids, point, kind="rb", landmark=9, sigma=0.1):
    """What poses of `straight`, or of a corner where the id is 4 or more, see of a point."""
    off = np.array(point) - [(k, 0) if k < 4 else (3, k - 3) for k in ids]
    return masat.range_bearing(
        [(k, landmark) for k in ids],
        np.hypot(*off.T) if "r" in kind else None,
        np.arctan2(off[:, 1], off[:, 0]) if "b" in kind else None,
        sigma_range=sigma if "r" in kind else None,
        sigma_bearing=sigma if "b" in kind else None,
    )


def test_the_residual_in_2d_is_the_range_and_the_bearing():
    # 5 away, in the direction atan2(4, 3), which is 4 / 25 per meter along x and 3 / 25 along y.
    e, jacobian = _core.range_bearing_errors(np.array([[3.0, 4]]), np.array([4.5]))
    assert_allclose(e, [[0.5, np.arctan2(4, 3)]], rtol=1e-15)
    assert_allclose(jacobian, [[[0.6, 0.8], [-4 / 25, 3 / 25]]], rtol=1e-15)


def test_the_residual_in_3d_is_the_angle_between_the_directions():
    # 2 ahead and 2 aside: 45 degrees, toward (0.6, 0.8) of the left and up.
    q = np.array([[2.0, 1.2, 1.6]])
    e, jacobian = _core.range_bearing_errors(q, np.array([2.0]))
    assert_allclose(e, [[8**0.5 - 2, 0.6 * np.pi / 4, 0.8 * np.pi / 4]], rtol=1e-15)
    # Across, the angle turns with the point: by pi / 4 at a distance of 2 from the axis.
    across = np.array([0, -0.8, 0.6])
    assert_allclose(jacobian[0] @ across, np.pi / 8 * across, atol=1e-15)
    # Aside, it grows as in 2D.
    assert_allclose(jacobian[0] @ [0, 0.6, 0.8], [0.5**0.5, 0.6 * 2 / 8, 0.8 * 2 / 8], atol=1e-15)


@pytest.mark.parametrize("d", [2, 3])
def test_derivatives_are_those_of_finite_differences(d):
    rng = np.random.default_rng(0)
    q, ranges = rng.normal(size=(50, d)) * 3, rng.uniform(0, 5, 50)
    _, jacobian = _core.range_bearing_errors(q, ranges)
    step = 1e-6
    for k in range(d):
        ends = [_core.range_bearing_errors(q + s * np.eye(d)[k], ranges)[0] for s in (step, -step)]
        assert_allclose(jacobian[:, :, k], (ends[0] - ends[1]) / (2 * step), rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("d", [2, 3])
def test_points_on_the_sensor_and_behind_it_have_finite_answers(d):
    q = np.zeros((6, d))
    q[1, 0], q[2, 0], q[3, 1], q[4, 0], q[5, :2] = -2, 3, 1e-13, -1e-200, (-1, 1e-15)
    e, jacobian = _core.range_bearing_errors(q, np.ones(6))
    assert np.isfinite(e).all()
    assert np.isfinite(jacobian).all()
    assert np.abs(jacobian).max() < 1e14
    # On the sensor the step leads to where the point was measured.
    assert_array_equal(e[0], np.eye(d)[0] * -1)
    assert_array_equal(jacobian[0], np.diag(np.eye(d)[0]))
    assert_allclose(e[1, :2], [1, np.pi])
    assert_allclose(e[2], np.eye(d)[0] * 2)
    assert_allclose(jacobian[2], np.diag([1, *[1 / 3] * (d - 1)]))


def test_directions_in_3d_are_bearing_and_elevation():
    along = _core.rotation_matrices(directions(np.array([(1, 0.3, 0.4), (2, 2.5, -1.1)])))[:, :, 0]
    for (b, up), axis in zip([(0.3, 0.4), (2.5, -1.1)], along, strict=True):
        expected = [np.cos(up) * np.cos(b), np.cos(up) * np.sin(b), np.sin(up)]
        assert_allclose(axis, expected, rtol=1e-14)


def test_the_cost_of_an_elevation_by_hand():
    # From a robot that looks along y, the point is 1 to the left and 1 up, 2^0.5 away.
    turned = (0, 0, 0, 0, 0, 0.5**0.5, 0.5**0.5)
    seen = masat.range_bearing(
        [(0, 9)], [1], [np.pi / 2], [0], sigma_range=0.5, sigma_bearing=1, sigma_elevation=0.25
    )
    graph = PoseGraph.from_arrays(
        [], np.empty((0, 7)), ids=[0], poses=[turned], landmarks=seen.with_positions([(-1, 0, 1)])
    )
    assert_allclose(graph.chi2, 4 * (2**0.5 - 1) ** 2 + 16 * (np.pi / 4) ** 2)


def test_what_is_measured_has_information():
    both = masat.range_bearing([(0, 9)], 2.0, 0.5, sigma_range=0.5, sigma_bearing=[0.25])
    assert_array_equal(both.measurements, [(2, 0.5)])
    assert_array_equal(both.information, [np.diag([4, 16])])
    bearing = masat.range_bearing([(0, 9)], None, 0.5, sigma_bearing=0.25)
    assert_array_equal(bearing.information, [np.diag([0, 16])])
    high = masat.range_bearing([(0, 9)], None, 0.5, 0.1, sigma_bearing=0.25)
    assert_array_equal(high.information, [np.diag([0, 16, 16])])
    assert masat.range_bearing([(0, 9)], 2, sigma_range=1, dimension=3).dimension == 3


BAD = [
    (([(0, 9)], [np.nan], [0]), {}, r"measurement of observation 0 \(0 -> 9\) is not finite"),
    (([(0, 9)], [-1], [0]), {}, r"the range of observation 0 \(0 -> 9\) is -1 m"),
    (([(0, 9)], [1], [np.inf]), {}, r"observation 0 \(0 -> 9\) is not finite"),
    (([(0, 9)], [1, 2], [0]), {}, "ranges must be one number or 1"),
    (([(0, 9)], [1], [0]), {"sigma_range": 0}, "sigma_range of observation 0 .* positive"),
    (([(0, 9)], [1], [0]), {"sigma_bearing": None}, "bearings without sigma_bearing"),
    (([(0, 9)], None, [0]), {}, "sigma_range without ranges"),
    (([(0, 9)],), {}, "give ranges, bearings or both"),
    (([(0, 9)], [1], None, [0]), {}, "a bearing and an elevation"),
    (([(0, 9)], [1], [0], [90]), {}, r"elevation of observation 0 .* is 90: .* radians"),
    (([(0, 9)], [1], [0], [0]), {"dimension": 2}, "elevations are measured in 3D"),
    (([(0, 9)], [1], [0]), {"dimension": 4}, "dimension must be 2 or 3"),
]


@pytest.mark.parametrize(("values", "more", "message"), BAD)
def test_bad_values_are_one_clear_error(values, more, message):
    with pytest.raises(GraphError, match=message):
        masat.range_bearing(*values, **({"sigma_range": 1, "sigma_bearing": 1} | more))


def test_flags_of_landmarks_are_checked():
    with pytest.raises(GraphError, match="true or false, or 1 of these"):
        masat.landmarks([(0, 9)], [(1, 1)], range_bearing=[True, False])
    assert masat.landmarks([(0, 9)], [(-1, 1)], range_bearing=[False]).range_bearing is None


def test_both_kinds_join_in_one_graph():
    point = masat.landmarks([(0, 9), (1, 8)], [(1, 1), (2, 2)], positions=[(3, 2), (1, 1)])
    both = point + seen_from([0], (1, 1))
    assert_array_equal(both.ids, [8, 9])
    assert_array_equal(both.range_bearing, [False, False, True])
    assert_array_equal(both.positions, [(3, 2), (1, 1)])
    graph = straight(landmarks=[point, seen_from([0], (1, 1))])
    assert_array_equal(graph.landmarks.observations, both.observations)
    more = graph.with_landmarks([graph.landmarks, seen_from([2], (0, 5), landmark=7)])
    assert more.points is None
    assert_array_equal(more.point_ids, [7, 8, 9])
    with pytest.raises(GraphError, match="landmark 9 has two different positions"):
        point + masat.landmarks([(0, 9)], [(1, 1)], positions=[(2, 2)])
    with pytest.raises(GraphError, match="2D and in 3D"):
        point + masat.landmarks([(0, 9)], [(1, 1, 1)])
    with pytest.raises(GraphError, match=r"made by masat\.landmarks or"):
        straight(landmarks=[masat.gps([0], [(0, 0)], 1)])


@pytest.mark.parametrize("init", INITIALIZERS)
@pytest.mark.parametrize("world", [manhattan, sphere])
def test_without_noise_every_initial_guess_finds_the_truth(world, init):
    if init == "lago" and world is sphere:
        pytest.skip("LAGO is for planar graphs")
    truth = add_landmarks(world(60), 12, sigma=0, sigma_bearing=0.0)
    unknown = masat.landmarks(
        truth.landmarks.observations,
        truth.landmarks.measurements,
        truth.landmarks.information,
        range_bearing=True,
    )
    graph = truth.with_landmarks(unknown).with_fixed(0)
    result = masat.solve(graph, init=init)
    assert result.chi2 < 1e-6
    assert_allclose(result.graph.points, truth.points, atol=1e-4)


@pytest.mark.parametrize("world", [manhattan, sphere])
def test_the_minimum_is_that_from_the_truth(world):
    truth = add_landmarks(world(200), 30, sigma=0.1, sigma_bearing=0.02, seed=1)
    noise = [0.05, 0.05, 0.02] if truth.dimension == 2 else [0.05, 0.02]
    noisy = perturb(truth, noise, seed=1)
    noisy = noisy.with_poses(truth.poses).with_fixed(0)
    from_truth = masat.optimize(noisy)
    result = masat.solve(noisy)
    assert_allclose(result.chi2, from_truth.chi2, rtol=1e-8)
    assert 0.8 < result.reduced_chi2 < 1.2
    assert len(result.history) <= 6
    wide = masat.landmark_covariances(result.graph)
    off = result.graph.points - truth.points
    # Within a common motion of the map, which the covariances hold, too.
    mahalanobis = np.einsum("ki,kij,kj->k", off, np.linalg.inv(wide), off)
    assert np.median(mahalanobis) < 10


@pytest.mark.filterwarnings("ignore::masat.MasatWarning")
@pytest.mark.parametrize("kind", ["b", "r"])
def test_bearings_alone_and_ranges_alone_reach_the_minimum_from_the_truth(kind):
    # Odometry alone, which has drifted, and landmarks that no single observation places.
    for seed in range(3):
        truth = add_landmarks(manhattan(300, seed=seed), 40, sigma=0.05, reach=10, seed=seed)
        noisy = perturb(truth, [0.03, 0.03, 0.01], seed=seed)
        steps = noisy.without_edges(np.abs(noisy.edges[:, 0] - noisy.edges[:, 1]) != 1)
        exact = truth.landmarks.measurements
        z = np.column_stack([np.hypot(*exact.T), np.arctan2(exact[:, 1], exact[:, 0])])
        seen = masat.range_bearing(
            truth.landmarks.observations,
            z[:, 0] if kind == "r" else None,
            z[:, 1] if kind == "b" else None,
            sigma_range=0.05 if kind == "r" else None,
            sigma_bearing=0.05 if kind == "b" else None,
        )
        graph = steps.with_landmarks(seen)
        from_truth = masat.optimize(graph.with_poses(truth.poses).with_points(truth.points))
        result = masat.solve(graph)
        assert result.chi2 < from_truth.chi2 * (1 + 1e-6)


def test_a_landmark_of_bearings_lies_where_the_rays_cross():
    result = masat.solve(straight(landmarks=seen_from([0, 2], (1, 3), "b")))
    assert_allclose(result.graph.points, [(1, 3)], atol=1e-6)
    assert result.graph.notes == ()


def test_what_a_single_bearing_leaves_open_is_said():
    with pytest.warns(MasatWarning, match=r"landmark 9: position along \(0.71, 0.71\) not det"):
        result = masat.solve(straight(landmarks=seen_from([0], (1, 1), "b")))
    x, y = result.graph.points[0]
    assert x == pytest.approx(y)
    assert x > 0
    assert result.chi2 < 1e-12
    with pytest.raises(OptimizationError, match=r"no covariances: landmark 9: position along"):
        masat.landmark_covariances(result.graph)


def test_a_landmark_along_the_line_of_motion_is_said():
    with pytest.warns(MasatWarning, match="landmark 9: position along x not determined"):
        result = masat.solve(straight(landmarks=seen_from([0, 1, 2], (9, 0), "b")))
    assert result.chi2 < 1e-9
    assert result.graph.points[0, 0] > 3


def test_rays_that_meet_behind_the_poses_survive():
    # They part ahead: the nearer to parallel rays the landmark is, the better it fits.
    seen = masat.range_bearing([(0, 9), (3, 9)], None, [1.5, 1.4], sigma_bearing=0.1)
    with pytest.warns(MasatWarning, match="landmark 9: position .*not determined"):
        result = masat.solve(straight(landmarks=seen))
    assert np.isfinite(result.graph.points).all()
    assert result.graph.points[0, 1] > 1
    assert result.chi2 < 2


def test_two_ranges_leave_two_positions_and_three_off_the_line_one():
    with pytest.warns(MasatWarning, match=r"landmark 9: two positions fit .*\(1, .*\(1, "):
        result = masat.solve(straight(landmarks=seen_from([0, 2], (1, 3), "r")))
    assert_allclose(np.abs(result.graph.points), [(1, 3)], atol=1e-6)
    corner = PoseGraph.from_arrays(
        [(0, 1), (1, 2), (2, 3), (3, 4), (4, 5)], [(1, 0, 0)] * 3 + [(0, 1, 0)] * 2
    )
    for point in ((1, 3), (1, -3)):
        exact = corner.with_landmarks(seen_from([0, 2, 5], point, "r"))
        result = masat.solve(exact)
        assert_allclose(result.graph.points, [point], atol=1e-6)
        assert result.graph.notes == ()


def test_a_bearing_decides_between_two_positions():
    seen = seen_from([0, 2], (1, -3), "r") + seen_from([1], (1, -3), "b")
    result = masat.solve(straight(landmarks=seen))
    assert_allclose(result.graph.points, [(1, -3)], atol=1e-6)
    assert result.graph.notes == ()


@pytest.mark.parametrize("d", [2, 3])
def test_a_range_of_zero_is_on_the_sensor(d):
    up = None if d == 2 else [0.2]
    seen = masat.range_bearing([(1, 9)], [0], [0.4], up, sigma_range=0.1, sigma_bearing=0.1)
    with pytest.warns(
        MasatWarning, match=r"landmark 9: position .*not determined \(seen only by one"
    ):
        result = masat.solve(straight(d, landmarks=seen))
    assert np.isfinite(result.chi2)
    assert_allclose(result.graph.points, [np.eye(d)[0]], atol=0.2)


def test_landmarks_of_bearings_in_3d_are_triangulated():
    turned = (1, 0, 0, 0, 0, np.sin(0.2), np.cos(0.2))
    seen = masat.range_bearing(
        [(0, 9), (1, 9)],
        None,
        [np.arctan2(2, 3), np.arctan2(2, 2) - 0.4],
        [np.arctan2(1, 13**0.5), np.arctan2(1, 8**0.5)],
        sigma_bearing=0.01,
    )
    graph = PoseGraph.from_arrays([(0, 1)], [turned], landmarks=seen)
    assert_allclose(masat.solve(graph).graph.points, [(3, 2, 1)], atol=1e-6)


@pytest.mark.filterwarnings("ignore::masat.MasatWarning")
def test_parts_that_bearings_alone_join_are_said():
    parts = PoseGraph.from_arrays([(0, 1), (10, 11)], [(1, 0, 0)] * 2)
    seen = masat.range_bearing(
        [(k, 20 + j) for j in range(6) for k in (0, 1, 10, 11)],
        None,
        np.linspace(-1, 1, 24),
        sigma_bearing=0.5,
    )
    result = masat.solve(parts.with_landmarks(seen))
    assert "2 parts of the graph are joined by bearings alone" in " ".join(result.graph.notes)
    assert np.isfinite(result.chi2)


def test_there_is_no_certificate_and_it_says_why():
    truth = add_landmarks(manhattan(100), 10, sigma=0.1, sigma_bearing=0.02)
    result = masat.solve(perturb(truth, [0.05, 0.05, 0.02]), certify=True)
    assert result.certificate.status == "undecided"
    assert "no bound of chi2 with observations of range or bearing" in result.certificate.message
    off = result.graph.with_points(result.graph.points + 0.5)
    found = masat.certify(off)
    assert found.status == "refuted"
    assert_allclose(found.better.chi2, result.chi2, rtol=1e-9)


def test_wrong_observations_lose_their_weight_under_a_loss():
    truth = add_landmarks(manhattan(100), 10, sigma=0, sigma_bearing=0.0)
    z = truth.landmarks.measurements.copy()
    z[::17, 1] += 2
    w = np.diag([100.0, 2500])
    wrong = masat.landmarks(truth.landmarks.observations, z, w, range_bearing=True)
    graph = perturb(truth, [0.01, 0.01, 0.01]).with_landmarks(wrong)
    with pytest.warns(MasatWarning, match="the map cannot be right"):
        result = masat.solve(graph, loss="cauchy")
    assert_allclose(result.graph.points, truth.points, atol=0.05)


def test_priors_may_name_such_landmarks():
    seen = seen_from([0, 1], (1, 3), "b")
    fixes = masat.gps([9], [(11, 3)], 0.1) + masat.gps([0], [(10, 0)], 0.1)
    result = masat.solve(straight(landmarks=seen, priors=fixes))
    assert_allclose(result.graph.points, [(11, 3)], atol=1e-6)
    assert_allclose(result.poses[:, :2], [(10 + k, 0) for k in range(4)], atol=1e-6)


def test_a_graph_that_has_ranges_only_by_name_is_solved_as_one_without():
    truth = add_landmarks(manhattan(60), 5, sigma=0.1)
    flagged = truth.with_landmarks(
        masat.landmarks(
            truth.landmarks.observations,
            truth.landmarks.measurements,
            truth.landmarks.information,
            range_bearing=False,
        )
    )
    assert masat.solve(flagged).chi2 == masat.solve(truth).chi2


@pytest.mark.parametrize(
    ("text", "more"),
    [
        ("0 4 5 .5\n1 4 4.5 .6 # tree\n", {"sigma_range": 0.1, "sigma_bearing": 0.02}),
        (
            "pose,landmark,range,bearing\n0,4,5,.5\n\n1, 4, 4.5, .6\n",
            {"sigma_range": 0.1, "sigma_bearing": 0.02},
        ),
        ("0 4 5 .5 .1 .02\n1 4 4.5 .6 .1 .02", {}),
    ],
)
def test_tables_are_read(text, more, tmp_path):
    (tmp_path / "seen.csv").write_text(text)
    seen = masat.read_observations(tmp_path / "seen.csv", first_id=100, **more)
    assert_array_equal(seen.observations, [(0, 104), (1, 104)])
    assert_array_equal(seen.measurements, [(5, 0.5), (4.5, 0.6)])
    assert_allclose(seen.information, [np.diag([100, 2500])] * 2)


def test_tables_in_3d_are_read(tmp_path):
    (tmp_path / "seen.txt").write_text("0 4 5 .5 .2 1 2 4\n")
    seen = masat.read_observations(tmp_path / "seen.txt")
    assert_array_equal(seen.measurements, [(5, 0.5, 0.2)])
    assert_array_equal(seen.information, [np.diag([1, 1 / 4, 1 / 16])])


SIGMAS = {"sigma_range": 1, "sigma_bearing": 1}


@pytest.mark.parametrize(
    ("text", "more", "message"),
    [
        ("", SIGMAS, "holds no observations"),
        ("0 1 2\n", SIGMAS, "seen.csv:1: 3 numbers; expected pose, landmark, range"),
        ("0 1 2 3\n0 1 2 3 4\n", SIGMAS, "2: 5 numbers; expected 4, as in the lines before"),
        ("0 1 2 3\n0 1.5 2 3\n", SIGMAS, "2: expected two integer ids"),
        ("0 1 2 x\n", SIGMAS, "1: expected two integer ids and then numbers"),
        ("0 1 2 3\n0 1 -2 3\n", SIGMAS, "2: the range of observation 1 .* is -2 m"),
        ("0 1 2 3\n\n0 1 nan 3\n", SIGMAS, "3: the measurement of observation 1 .* not finite"),
        ("0 1 2 3\n", {}, "no standard deviations: give"),
        ("0 1 2 3 1 1\n", SIGMAS, "has standard deviations: give no others"),
        ("0 1 2 3 1 0\n", {}, "1: sigma_bearing of observation 0 .* must be positive"),
        (f"0 {2**63} 2 3\n", SIGMAS, "at most 64 bits"),
    ],
)
def test_bad_tables_are_one_clear_error(text, more, message, tmp_path):
    (tmp_path / "seen.csv").write_text(text)
    with pytest.raises(FormatError, match=message):
        masat.read_observations(tmp_path / "seen.csv", **more)


@pytest.mark.parametrize("world", [manhattan, sphere])
def test_the_minimum_is_that_of_gtsam(world):
    gtsam = pytest.importorskip("gtsam")
    truth = add_landmarks(world(150), 20, sigma=0.1, sigma_bearing=0.02, seed=2)
    d = truth.dimension
    # Small noise, so that gtsam's residual of a rotation and a translation is ours.
    noise = [0.05, 0.05, 1e-3] if d == 2 else [0.05, 1e-3]
    noisy = perturb(truth, noise, seed=2)
    ours = masat.solve(noisy)
    pose = (
        (lambda p: gtsam.Pose2(*p))
        if d == 2
        else (lambda p: gtsam.Pose3(gtsam.Rot3.Quaternion(p[6], *p[3:6]), p[:3]))
    )
    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    sigmas = [0.05, 0.05, 1e-3] if d == 2 else [1e-3] * 3 + [0.05] * 3
    model = gtsam.noiseModel.Diagonal.Sigmas(np.array(sigmas))
    between = gtsam.BetweenFactorPose2 if d == 2 else gtsam.BetweenFactorPose3
    for (a, b), z in zip(noisy.edges.tolist(), noisy.measurements, strict=True):
        factors.add(between(a, b, pose(z), model))
    seen, edges = noisy.landmarks, len(noisy.edges)
    model = gtsam.noiseModel.Diagonal.Sigmas(np.array([0.02] * (d - 1) + [0.1]))
    along = _core.rotation_matrices(directions(seen.measurements))[:, :, 0]
    for (a, b), z, ray in zip(seen.observations.tolist(), seen.measurements, along, strict=True):
        if d == 2:
            bearing = gtsam.Rot2.fromAngle(float(z[1]))
            factors.add(gtsam.BearingRangeFactor2D(a, b, bearing, float(z[0]), model))
        else:
            factors.add(gtsam.BearingRangeFactor3D(a, b, gtsam.Unit3(ray), float(z[0]), model))
    first = gtsam.NonlinearEqualityPose2 if d == 2 else gtsam.NonlinearEqualityPose3
    factors.add(first(0, pose(truth.poses[0])))
    for k, p in enumerate(truth.poses):
        values.insert(k, pose(p))
    for k, p in zip(truth.point_ids.tolist(), truth.points, strict=True):
        values.insert(k, p)
    options = gtsam.LevenbergMarquardtParams()
    options.setRelativeErrorTol(1e-14)
    options.setAbsoluteErrorTol(0)
    found = gtsam.LevenbergMarquardtOptimizer(factors, values, options).optimize()
    assert_allclose(ours.chi2, 2 * factors.error(found), rtol=1e-5)
    theirs = [2 * factors.at(edges + k).error(values) for k in range(len(seen.observations))]
    at_truth = noisy.with_poses(truth.poses).chi2_per_observation
    assert_allclose(theirs, at_truth, rtol=1e-9)
