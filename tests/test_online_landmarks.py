"""Landmarks and lever arms in maps that grow."""

import numpy as np
import pytest
from random_graphs import random_graph

import masat
from masat import GraphError, OnlineMap, OptimizationError, lie, worlds
from masat.online.stream import replay
from masat.worlds.landmarks import ranges_and_bearings


def batch(graph):
    """The batch solver's optimum from the poses of a graph."""
    return masat.optimize(graph, relative_tolerance=1e-14, max_iterations=200)


def world_with_landmarks(dimension, *, seed=1, polar=False, lever=False):
    """A noisy world with landmarks, and perhaps position fixes beside each node."""
    world = worlds.manhattan(150, seed=seed) if dimension == 2 else worlds.grid(100)
    sigmas = (0.05, 0.05, 0.02) if dimension == 2 else (0.05, 0.02)
    noisy = worlds.perturb(world, sigmas, seed=seed).with_poses(world.poses)
    bearing = 0.02 if polar else None
    graph = worlds.add_landmarks(
        noisy, 25, sigma=0.1, reach=4, sigma_bearing=bearing, seed=seed
    ).with_fixed([])
    if lever:
        arms = 0.5 * np.random.default_rng(seed).normal(size=(15, dimension))
        nodes = world.ids[:: len(world) // 15][:15]
        at = lie.compose(world.poses[world.index(nodes)], as_poses(arms))[:, :dimension]
        graph = graph.with_priors(masat.gps(nodes, at, 0.3, lever_arm=arms))
    return graph


def as_poses(points):
    poses = np.tile(lie.identity(points.shape[1]), (len(points), 1))
    poses[:, : points.shape[1]] = points
    return poses


def state(world):
    graph = world.graph()
    seen = graph.landmarks
    return (
        world.poses.tolist(),
        world.points.tolist(),
        world.point_ids.tolist(),
        world.waiting_observations.tolist(),
        world.waiting_priors.tolist(),
        graph.edges.tolist(),
        None if seen is None else seen.observations.tolist(),
    )


def corridor(count=4, **options):
    """A straight walk of one meter a step, without noise."""
    world = OnlineMap(2, **options)
    for k in range(count):
        world.add_pose(k)
        if k:
            world.add_edges((k - 1, k), (1, 0, 0), 100 * np.eye(3))
    world.update()
    return world


def test_the_first_observation_places_a_landmark_and_the_mean_is_weighted():
    world = corridor(tolerance=0)
    numbers = world.add_observations(masat.landmarks([(1, 50)], [(2, 1)]))
    assert numbers.tolist() == [3]
    assert world.points.shape == (0, 2)
    world.update()
    np.testing.assert_allclose(world.point(50), (3, 1))
    assert world.point_ids.tolist() == [50]
    assert len(world) == 4
    assert world.poses.shape == (4, 3)
    assert world.ids.tolist() == [0, 1, 2, 3]
    # Odometry from the first pose makes the rest nearly exact.
    world.add_edges([(0, k) for k in (1, 2, 3)], [(k, 0, 0) for k in (1, 2, 3)], 1e12 * np.eye(3))
    world.add_observations(masat.landmarks([(3, 50)], [(0, 4)], 2 * np.eye(2)))
    done = world.update()
    np.testing.assert_allclose(world.point(50), (3, 3), atol=1e-6)
    assert done.chi2 == pytest.approx(1 * 4 + 2 * 1, rel=1e-6)
    np.testing.assert_allclose(world.landmark_covariances([50])[0], np.eye(2) / 3, atol=1e-6)


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("polar", [False, True])
@pytest.mark.parametrize("lever", [False, True])
def test_a_stream_ends_at_the_optimum_of_all_measurements(dimension, polar, lever):
    graph = world_with_landmarks(dimension, polar=polar, lever=lever)
    expected = masat.solve(graph)
    run = replay(graph)
    assert len(run.map.waiting_observations) == len(run.map.waiting_priors) == 0
    assert run.map.chi2 < expected.chi2 * (1 + 1e-3)
    own = run.map.graph()
    assert own.chi2 == pytest.approx(run.map.chi2, rel=1e-9)
    assert len(own.landmarks.observations) == len(graph.landmarks.observations)
    result = run.map.optimize()
    assert result.chi2 == pytest.approx(expected.chi2, rel=1e-9)
    assert np.abs(lie.local(result.poses, expected.poses)).max() < 1e-4
    in_order = result.poses[result.graph.index(run.map.ids)]
    np.testing.assert_allclose(run.map.poses, in_order, atol=1e-14)
    order = np.searchsorted(result.graph.point_ids, run.map.point_ids)
    np.testing.assert_allclose(run.map.points, result.graph.points[order], atol=1e-12)


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("seed", range(3))
def test_any_order_of_additions_and_removals(dimension, seed):
    """Edges, observations and fixes in random order; parts join and fall apart."""
    random = np.random.default_rng(300 + seed)
    graph = random_graph(dimension, 30, 30, 300 + seed, noise=0.02)
    points = random.normal(0, 5, (8, dimension))
    pairs = np.column_stack([random.integers(30, size=60), random.integers(8, size=60)])
    there = lie.between(graph.poses[pairs[:, 0]], as_poses(points[pairs[:, 1]]))[:, :dimension]
    z = there + 0.02 * random.normal(size=there.shape)
    polar = ranges_and_bearings(there, 0.01 * random.normal(size=there.shape))
    kind = random.choice(["position", "range and bearing", "bearing"], len(pairs))
    nodes = random.integers(30, size=12)
    arms = random.normal(size=(12, dimension))
    fixes = lie.compose(graph.poses[nodes], as_poses(arms))[:, :dimension]
    fixes += 0.05 * random.normal(size=fixes.shape)
    world = OnlineMap(dimension, tolerance=0)
    for node in random.permutation(graph.ids):
        world.add_pose(int(node))

    def add(row):
        if row < len(graph.edges):
            return world.add_edges(
                graph.edges[row], graph.measurements[row], graph.information[row]
            )
        row -= len(graph.edges)
        if row < len(pairs):
            w = np.diag([1.0] * dimension) * (1 if kind[row] == "position" else 100)
            w[0, 0] *= kind[row] != "bearing"
            measured = z if kind[row] == "position" else polar
            seen = masat.landmarks(
                pairs[row : row + 1] + np.array([0, 100]),
                measured[row : row + 1],
                w,
                range_bearing=kind[row] != "position",
            )
            return world.add_observations(seen)
        row -= len(pairs)
        return world.add_priors(
            masat.gps(nodes[row : row + 1], fixes[row : row + 1], 0.1, lever_arm=arms[row])
        )

    inside = {}
    outside = random.permutation(len(graph.edges) + len(pairs) + len(nodes)).tolist()
    for _ in range(200):
        if outside and (not inside or random.random() < 0.65):
            row = outside.pop()
            inside[int(add(row)[0])] = row
        else:
            number = int(random.choice(list(inside)))
            outside.insert(0, inside.pop(number))
            world.remove_edges(number)
        if random.random() < 0.5:
            world.update()
    world.update()
    check_against_the_batch(world, inside)
    for row in outside:
        inside[int(add(row)[0])] = row
    world.update()
    assert len(world.waiting_priors) == 0
    # Bearings of a landmark that nothing else measures may nearly be parallel.
    assert len(world.waiting_observations) <= 3
    check_against_the_batch(world, inside)


def check_against_the_batch(world, inside):
    own = world.graph()
    held = len(own.edges)
    held += 0 if own.priors is None else len(own.priors)
    held += 0 if own.landmarks is None else len(own.landmarks.observations)
    waiting = {*world.waiting_priors.tolist(), *world.waiting_observations.tolist()}
    assert waiting <= set(inside)
    assert held + len(waiting) == len(inside)
    best = batch(own)
    assert world.chi2 == pytest.approx(own.chi2, rel=1e-9, abs=1e-12)
    assert own.chi2 == pytest.approx(best.chi2, rel=1e-8, abs=1e-12)
    assert np.abs(lie.local(best.poses, own.poses)).max() < 1e-5
    at = own.with_poses(world._core.linearized(world._core.find_all(own.ids)))
    indices = world._core.find_all(own.point_ids)
    if len(indices):
        at = at.with_points(world._core.linearized(indices)[:, : world.dimension])
        seen = np.isin(own.point_ids, own.landmarks.observations[:, 1])
        ids = own.point_ids[seen]
        np.testing.assert_allclose(
            world.landmark_covariances(ids), masat.landmark_covariances(at, ids), atol=1e-9
        )
    np.testing.assert_allclose(world.covariances(own.ids), masat.covariances(at), atol=1e-9)


def test_bearings_wait_until_they_cross():
    world = corridor(tolerance=0)
    at = np.array([2.0, 3.0])
    for k in range(4):
        world.add_observations(
            masat.range_bearing(
                [(k, 9)], bearings=[np.arctan2(at[1], at[0] - k)], sigma_bearing=0.01
            )
        )
        world.update()
        if k == 0:
            assert world.point_ids.tolist() == []
            assert world.graph().landmarks is None
            assert len(world.waiting_observations) == 1
            with pytest.raises(GraphError, match="not determined yet"):
                world.point(9)
    assert len(world.waiting_observations) == 0
    np.testing.assert_allclose(world.point(9), at, atol=1e-6)


def test_a_landmark_is_placed_by_the_part_that_determines_it():
    world = OnlineMap(2, tolerance=0)
    for first in (0, 10):
        for k in range(2):
            world.add_pose(first + k)
            if k:
                world.add_edges((first, first + k), (1, 0, 0), 100 * np.eye(3))
    # The first part drives toward the landmark; from the second, the bearings cross at (1, 1).
    seen = [(0, 9), (1, 9), (10, 9), (11, 9)]
    bearings = [0, 0, np.pi / 4, np.pi / 2]
    world.add_observations(masat.range_bearing(seen, bearings=bearings, sigma_bearing=0.01))
    world.update()
    np.testing.assert_allclose(world.point(9), world.pose(10)[:2] + 1, atol=1e-6)


def test_a_bearing_waits_if_what_placed_its_landmark_goes_at_the_same_time():
    world = OnlineMap(2)
    world.add_pose(0)
    placed = world.add_observations(
        masat.landmarks([(0, 9)], [(4.1, -0.35)], 1000 * np.eye(2), range_bearing=True)
    )
    world.update()
    bearing = masat.range_bearing([(0, 9)], bearings=[-0.39], sigma_bearing=0.03)
    waits = world.add_observations(bearing)
    world.remove_edges(placed)
    world.update()
    assert world.waiting_observations.tolist() == waits.tolist()
    assert world.chi2 == 0
    if len(world.points):
        assert np.abs(world.points).max() < 5
    world.add_observations(masat.landmarks([(0, 9)], [(3, -1)], 1000 * np.eye(2)))
    world.update()
    assert len(world.waiting_observations) == 0
    np.testing.assert_allclose(world.point(9), (3, -1), atol=0.2)


def test_a_landmark_of_which_nothing_is_left_has_no_position():
    world = corridor()
    bearing = masat.range_bearing([(0, 9)], bearings=[0.1], sigma_bearing=0.01)
    waits = world.add_observations(bearing)
    world.update()
    world.remove_edges(waits)
    world.update()
    assert world.point_ids.tolist() == []
    world.remove_edges(world.add_observations(masat.landmarks([(1, 8)], [(1, 1)])))
    world.update()
    assert world.point_ids.tolist() == []
    assert world.graph().landmarks is None
    world.add_observations(masat.landmarks([(1, 8), (1, 9)], [(1, 1), (1, 2)]))
    world.update()
    np.testing.assert_allclose(world.points, [(2, 2), (2, 1)])


def test_ranges_wait_until_no_mirror_image_fits():
    world = corridor(tolerance=0)
    at = np.array([2.0, 3.0])

    def seen(k):
        where = world.pose(k)[:2]
        distance = np.linalg.norm(at - where)
        return masat.range_bearing([(k, 9)], [distance], sigma_range=0.01)

    for k in range(4):
        world.add_observations(seen(k))
        world.update()
    # On the line of the poses, two positions fit.
    assert world.point_ids.tolist() == []
    world.add_pose(4)
    world.add_edges((3, 4), (0, 2, 0), 100 * np.eye(3))
    world.update()
    world.add_observations(seen(4))
    world.update()
    np.testing.assert_allclose(world.point(9), at, atol=1e-6)


def test_parts_that_see_the_same_landmarks_join():
    world = OnlineMap(2, tolerance=0)
    for first in (0, 10):
        for k in range(3):
            world.add_pose(first + k)
            if k:
                world.add_edges((first + k - 1, first + k), (1, 0, 0), 100 * np.eye(3))
    # The second part goes along the y axis of the first one, from (5, 0).
    points = np.array([(4.0, 1.0), (6.0, 2.0)])
    for j, (x, y) in enumerate(points):
        world.add_observations(masat.landmarks([(0, 20 + j)], [(x, y)], 100 * np.eye(2)))
        world.update()
        world.add_observations(masat.landmarks([(10, 20 + j)], [(y, 5 - x)], 100 * np.eye(2)))
        world.update()
        assert len(world.waiting_observations) == (1 if j == 0 else 0)
    np.testing.assert_allclose(world.pose(12), (5, 2, np.pi / 2), atol=1e-9)
    assert world.chi2 < 1e-12
    assert world.graph().gauge.tolist() == [0]
    # With one of the landmarks alone the parts fall apart, and stay where they are.
    world.remove_edges([7])
    world.update()
    assert len(world.waiting_observations) == 1
    assert world.graph().gauge.tolist() == [0, 10]
    np.testing.assert_allclose(world.pose(12), (5, 2, np.pi / 2), atol=1e-9)


def test_a_part_that_hangs_on_landmarks_is_fixed_when_they_are_not_enough():
    world = corridor(6, tolerance=0)
    where = np.array([(2.0, 2.0), (3.0, -2.0)])
    numbers = [
        world.add_observations(
            masat.landmarks([(k, 30 + j) for j in range(2)], where - (k, 0), 100 * np.eye(2))
        )
        for k in range(6)
    ]
    world.update()
    assert world.graph().gauge.tolist() == [0]
    world.remove_edges(2)  # from pose 2 to pose 3
    world.update()
    assert world.graph().gauge.tolist() == [0]
    assert len(world.waiting_observations) == 0
    world.remove_edges([n[1] for n in numbers[3:]])
    world.update()
    own = world.graph()
    assert own.gauge.tolist() == [0, 3]
    assert len(world.waiting_observations) == 3
    np.testing.assert_allclose(world.poses, [(k, 0, 0) for k in range(6)], atol=1e-9)
    assert np.isfinite(world.covariances()).all()


def test_fixes_that_are_left_may_be_too_few():
    world = corridor(tolerance=0)
    numbers = world.add_priors(masat.gps([0, 3], [(10, 0), (10, 3)], 0.1))
    world.update()
    assert world.graph().gauge.tolist() == []
    world.remove_edges(numbers[0])
    world.update()
    assert world.waiting_priors.tolist() == [numbers[1]]
    assert world.graph().gauge.tolist() == [0]
    np.testing.assert_allclose(world.pose(3), (10, 3, np.pi / 2), atol=1e-6)


def test_a_landmark_that_nothing_sees_any_more_stays_and_may_be_seen_again():
    world = corridor(tolerance=0)
    number = world.add_observations(masat.landmarks([(1, 7)], [(1, 1)]))
    world.update()
    world.remove_edges(number)
    world.update()
    np.testing.assert_allclose(world.point(7), (2, 1))
    assert np.abs(world.landmark_covariances()).max() == 0
    world.add_observations(masat.landmarks([(3, 7)], [(1, 2)]))
    world.update()
    np.testing.assert_allclose(world.point(7), (4, 2))
    # Also from a part that is younger than the landmark.
    world.add_pose(90)
    world.add_pose(91)
    world.add_edges((90, 91), (1, 0, 0))
    world.remove_edges(4)
    world.add_observations(masat.landmarks([(91, 7)], [(1, 0)]))
    world.update()
    world.add_observations(masat.landmarks([(91, 7)], [(1, 0)]))
    world.update()
    assert world.chi2 < 1e-12


def test_a_lever_arm_turns_with_the_pose():
    world = OnlineMap(2, tolerance=0)
    for k in range(3):
        world.add_pose(k)
        if k:
            world.add_edges((k - 1, k), (1, 0, 0), 100 * np.eye(3))
        # The antenna is a meter to the left of a robot that drives along the y axis.
        world.add_priors(masat.gps([k], [(4, k)], 0.01, lever_arm=(0, 1)))
        world.update()
    np.testing.assert_allclose(world.poses, [(5, k, np.pi / 2) for k in range(3)], atol=1e-9)
    assert world.chi2 < 1e-12
    assert world.graph().priors.offsets.tolist() == [[0, 1, 0]] * 3


def test_surveyed_landmarks_place_the_map_in_the_world():
    world = OnlineMap(2, tolerance=0)
    world.add_pose(0)
    world.add_observations(masat.landmarks([(0, 5), (0, 6)], [(1, 0), (0, 1)], 1e4 * np.eye(2)))
    world.update()
    world.add_priors(masat.gps([5, 6], [(10, 21), (9, 20)], 0.01))
    world.update()
    np.testing.assert_allclose(world.pose(0), (10, 20, np.pi / 2), atol=1e-9)
    np.testing.assert_allclose(world.points, [(10, 21), (9, 20)], atol=1e-9)


def test_an_update_that_cannot_be_done_forgets_landmarks_as_well():
    world = corridor()
    world.add_observations(masat.landmarks([(0, 70)], [(1, 1)]))
    world.update()
    before = state(world)
    world.add_observations(masat.landmarks([(0, 80), (1, 70)], [(1, 1), (0, 1)]))
    world.add_observations(masat.range_bearing([(0, 81)], bearings=[0.1], sigma_bearing=0.1))
    world.add_edges([(0, 3)], [(1e200, 0, 0)])
    world.remove_edges(3)
    with pytest.raises(OptimizationError):
        world.update()
    assert state(world) == before
    world.update()
    assert state(world) == before
    world.add_observations(masat.landmarks([(0, 80)], [(1, 1)]))
    world.update()
    assert world.point_ids.tolist() == [70, 80]


def see(pairs, z, **options):
    return lambda w: w.add_observations(masat.landmarks(pairs, z, **options))


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (
            see([(0, 70), (9, 70)], [(1, 1)] * 2),
            r"observation 1 \(9 -> 70\) names pose 9",
        ),
        (see([(70, 71)], [(1, 1)]), "names pose 70, which is a landmark"),
        (see([(0, 3)], [(1, 1)]), "the id 3 is that of a pose and of a landmark"),
        (see([(0, 71)], [(1, 1, 1)]), "the map is 2D, and the landmarks are 3D"),
        (see([(0, 71)], [(1, 1)], ids=[71, 72]), "landmark 72 has neither"),
        (lambda w: w.add_observations([(0, 71)]), "made by masat.landmarks"),
        (lambda w: w.add_pose(70), "has a node 70 already"),
        (lambda w: w.add_edges((0, 70), (1, 0, 0)), "names node 70, which is a landmark"),
        (lambda w: w.pose(70), "no node 70"),
        (lambda w: w.point(3), "no landmark 3"),
        (lambda w: w.covariances([70]), "no node 70"),
        (lambda w: w.relative_covariances([(0, 70)]), "no node 70"),
        (lambda w: w.landmark_covariances([3]), "no landmark 3"),
        (
            lambda w: w.add_priors(masat.pose_priors([0, 70], [(0, 0, 0)] * 2)),
            "prior 1 of landmark 70 measures a rotation",
        ),
        (
            lambda w: w.add_priors(masat.gps([70], [(0, 0)], 1, lever_arm=(1, 0))),
            "prior 0 of landmark 70 .* has an offset",
        ),
    ],
)
def test_errors_leave_the_map_as_it_is(call, text):
    world = corridor()
    world.add_observations(masat.landmarks([(0, 70)], [(1, 1)]))
    world.update()
    before = state(world)
    with pytest.raises(GraphError, match=text):
        call(world)
    world.update()
    assert state(world) == before


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("polar", [False, True])
def test_a_loaded_map_goes_on_where_the_other_was(dimension, polar, tmp_path):
    graph = world_with_landmarks(dimension, polar=polar, lever=True)
    world = replay(graph).map
    lonely = masat.range_bearing([(0, 100_000)], [3.0], sigma_range=0.1, dimension=dimension)
    world.add_observations(lonely)
    world.update()
    world.save(tmp_path / "map.npz")
    other = OnlineMap.load(tmp_path / "map.npz")
    assert state(other)[2:] == state(world)[2:]
    np.testing.assert_allclose(other.poses, world.poses, rtol=1e-14, atol=1e-14)
    np.testing.assert_allclose(other.points, world.points, rtol=1e-14, atol=1e-14)
    assert other.chi2 == pytest.approx(world.chi2, rel=1e-10)
    np.testing.assert_allclose(
        other.landmark_covariances(), world.landmark_covariances(), rtol=1e-7, atol=1e-14
    )
    arrays = dict(np.load(tmp_path / "map.npz"))
    for name, bad in (
        ("points", ~arrays["points"]),
        ("sensor_ends", arrays["sensor_ends"] + 10_000),
        ("sensor_ends", arrays["sensor_ends"][:, ::-1]),
        ("sensor_information", -arrays["sensor_information"]),
        ("sensor_offsets", arrays["sensor_offsets"] * np.nan),
    ):
        np.savez(tmp_path / "bad.npz", **{**arrays, name: bad})
        with pytest.raises(masat.FormatError):
            OnlineMap.load(tmp_path / "bad.npz")


def test_a_robust_map_leaves_out_wrong_observations_in_the_end():
    graph = world_with_landmarks(2)
    seen = graph.landmarks
    z = seen.measurements.copy()
    bad = np.arange(0, len(z), 12)
    z[bad] += 20
    wrong = graph.with_landmarks(masat.landmarks(seen.observations, z, seen.information))
    world = replay(wrong, robust=True).map
    world.optimize()
    left = world.graph().landmarks
    kept = {tuple(pair) for pair in left.observations.tolist()}
    assert not kept & {tuple(pair) for pair in seen.observations[bad].tolist()}
    assert len(left.observations) >= 0.95 * (len(z) - len(bad))
    assert len(left.observations) + len(world.rejected_observations) == len(z)
    good = masat.solve(graph)
    assert np.abs(lie.local(good.poses, world.graph().poses)).max() < 0.3
