import numpy as np
import pytest

import masat
from masat import GraphError, PoseGraph, lie
from masat.initializers import INITIALIZERS
from masat.residuals import chi2_per_edge
from masat.worlds import WORLDS, city, garage, grid, manhattan, perturb, sphere, torus
from masat.worlds.closures import on_lattice, within

# Meters that a step and a loop closure span at most.
REACHES = {
    "manhattan": (1, 1),
    "city": (1, 1),
    "sphere": (1, 0.52),
    "torus": (1.01, 1.5),
    "grid": (1, 1),
    "garage": (1.01, 3.2),
}


def reach_of(world):
    gap = world.edges[:, 1] - world.edges[:, 0]
    reach = np.linalg.norm(world.measurements[:, : world.dimension], axis=1)
    return gap, reach


@pytest.mark.parametrize("name", WORLDS)
@pytest.mark.parametrize(("nodes", "edges"), [(400, 600), (1001, 1700), (400, 399)])
def test_a_world_is_a_chain_with_closures_and_consistent(name, nodes, edges):
    world = WORLDS[name](nodes, edges, seed=3)
    assert (world.ids == np.arange(nodes)).all()
    assert len(world.edges) == edges
    assert chi2_per_edge(world).sum() < 1e-20
    gap, reach = reach_of(world)
    assert (world.edges[gap == 1, 0] == np.arange(nodes - 1)).all()
    assert (gap >= 1).all()
    assert (np.diff(world.edges[:, 1]) >= 0).all()
    assert len(np.unique(world.edges, axis=0)) == edges
    step, closure = REACHES[name]
    assert (reach[gap == 1] <= step + 1e-9).all()
    assert (reach[gap > 1] <= closure + 1e-9).all()
    assert (world.information == np.eye(world.dof)).all()


@pytest.mark.parametrize(
    ("name", "nodes", "edges"),
    [
        ("manhattan", 3500, 5453),
        ("city", 10000, 20687),
        ("sphere", 2500, 4949),
        ("torus", 5000, 9048),
        ("grid", 8000, 22800),
        ("garage", 1661, 6275),
    ],
)
def test_worlds_have_the_sizes_of_the_public_graphs(name, nodes, edges):
    world = WORLDS[name]()
    assert (len(world.ids), len(world.edges)) == (nodes, edges)


def test_a_manhattan_may_be_as_dense_as_manhattan10000():
    assert len(manhattan(10000, 64311).edges) == 64311
    assert len(manhattan(10000, 64311, extent=25).edges) == 64311


@pytest.mark.parametrize("name", WORLDS)
@pytest.mark.parametrize("nodes", [2, 3, 7, 20])
def test_a_small_world_has_what_closures_it_offers(name, nodes):
    world = WORLDS[name](nodes)
    assert len(world.ids) == nodes
    assert chi2_per_edge(world).sum() < 1e-20


@pytest.mark.parametrize("name", WORLDS)
def test_every_initializer_returns_the_truth_of_a_world(name):
    world = WORLDS[name](500, 800, seed=1)
    truth = lie.between(world.poses[0], world.poses)
    for init in INITIALIZERS:
        if init == "lago" and world.dimension == 3:
            continue
        guess = masat.initialize(world, init).poses
        assert np.abs(lie.local(truth, lie.between(guess[0], guess))).max() < 1e-9


@pytest.mark.parametrize("name", WORLDS)
def test_the_seed_makes_the_world(name):
    one, same, other = (WORLDS[name](500, 700, seed=s) for s in (1, 1, 2))
    assert (one.poses == same.poses).all()
    assert (one.edges == same.edges).all()
    assert (one.edges != other.edges).any()


@pytest.mark.parametrize("name", WORLDS)
def test_worlds_that_cannot_be_are_refused(name):
    with pytest.raises(GraphError, match="two nodes"):
        WORLDS[name](1, 0)
    with pytest.raises(GraphError, match="98 edges"):
        WORLDS[name](100, 98)
    with pytest.raises(GraphError, match="loop closures"):
        WORLDS[name](100, 6000)
    with pytest.raises(GraphError, match="seed"):
        WORLDS[name](100, seed=-1)


@pytest.mark.parametrize("name", WORLDS)
@pytest.mark.parametrize("value", [100.0, "100", None, [100], True, np.nan])
def test_sizes_and_seeds_that_are_no_integers_are_refused(name, value):
    with pytest.raises(GraphError, match="nodes must be an integer"):
        WORLDS[name](value)
    if value is not None:
        with pytest.raises(GraphError, match="edges must be an integer"):
            WORLDS[name](100, value)
    with pytest.raises(GraphError, match="seed must be an integer"):
        WORLDS[name](100, seed=value)
    with pytest.raises(GraphError, match="at most 2147483647 nodes"):
        WORLDS[name](2**31)


def test_impossible_measures_are_refused():
    for make in (manhattan, city):
        with pytest.raises(GraphError, match="extent must be an integer"):
            make(100, extent=10.5)
    with pytest.raises(GraphError, match="block must be an integer"):
        city(100, block="5")
    with pytest.raises(GraphError, match="storeys must be an integer"):
        garage(100, storeys=2.5)
    with pytest.raises(GraphError, match="extent"):
        manhattan(100, extent=0)
    with pytest.raises(GraphError, match="block"):
        city(100, block=0)
    with pytest.raises(GraphError, match="block"):
        city(100, block=10, extent=9)
    with pytest.raises(GraphError, match="storey"):
        garage(100, storeys=0)


def test_a_city_turns_only_at_crossings_and_never_back():
    world = city(3000, 5000, block=7, extent=70, seed=4)
    quarters = np.rint(world.poses[:, 2] / (np.pi / 2)).astype(int)
    turned = np.diff(quarters) % 4
    assert (turned != 2).all()
    assert ((np.flatnonzero(turned[1:]) + 1) % 7 == 0).all()
    assert (np.ptp(world.poses[:, :2], axis=0) <= 70).all()


@pytest.mark.parametrize("make", [sphere, torus, grid, garage])
def test_robots_in_space_face_the_next_pose(make):
    world = make(700, 900)
    gap, reach = reach_of(world)
    ahead = world.measurements[gap == 1, :3] / reach[gap == 1, None]
    assert np.allclose(ahead, [1, 0, 0], atol=1e-12)


def test_the_sphere_and_the_torus_have_their_shapes():
    points = sphere(900).poses[:, :3]
    assert np.allclose(np.linalg.norm(points, axis=1), 30 / (2 * np.pi))
    points = torus(1800).poses[:, :3]
    tube = np.hypot(np.hypot(points[:, 0], points[:, 1]) - 30 / np.pi, points[:, 2])
    assert np.allclose(tube, 30 / (2 * np.pi))


def test_the_torus_is_closed_around_its_ring():
    gap, _ = reach_of(torus(1800, 1799 + 1800))
    assert np.count_nonzero(gap == 1800 - 30) == 30


def test_the_grid_visits_each_place_of_the_cube_once():
    world = grid(216)
    assert (np.unique(world.poses[:, :3], axis=0) == np.argwhere(np.ones((6, 6, 6)))).all()
    assert len(world.edges) == 3 * 6 * 6 * 5


def test_the_garage_has_storeys_with_closures_on_them_and_between_them():
    world = garage(1661, 6275)
    z = world.poses[:, 2]
    heights, count = np.unique(z, return_counts=True)
    assert (heights[count > 20] == [0, 3, 6, 9, 12]).all()
    gap, _ = reach_of(world)
    rise = np.abs(np.diff(z[world.edges[gap > 1]], axis=1))
    assert np.count_nonzero(rise == 0) > 500
    assert np.count_nonzero(rise == 3) > 500
    assert (garage(800, 1500, storeys=1).poses[:, 2] == 0).mean() > 0.9


@pytest.mark.parametrize("dimension", [1, 2, 3])
def test_near_pairs_are_those_of_a_plain_search(dimension):
    random = np.random.default_rng(dimension)
    cells = random.integers(-4, 5, (150, dimension))
    apart = np.linalg.norm(cells[:, None] - cells, axis=2)
    near = on_lattice(cells)
    earlier, later = np.nonzero(np.triu(apart <= 1, 2))
    assert near.count == len(earlier)
    assert set(map(tuple, near.pairs(np.arange(near.count)))) == set(
        zip(earlier, later, strict=True)
    )
    points = random.uniform(-3, 3, (150, dimension))
    apart = np.linalg.norm(points[:, None] - points, axis=2)
    plain = set(zip(*np.nonzero(np.triu(apart <= 0.7, 5)), strict=True))
    assert set(map(tuple, within(points, 0.7, 5))) == plain


def test_the_truth_of_a_manhattan_is_consistent_and_on_the_grid():
    world = manhattan(600, 1000, extent=12, seed=5)
    assert (len(world.ids), len(world.edges)) == (600, 1000)
    assert chi2_per_edge(world).sum() < 1e-25
    points = world.poses[:, :2]
    assert (points == np.rint(points)).all()
    assert (np.ptp(points, axis=0) <= 12).all()
    assert (world.measurements[:, :2] == np.rint(world.measurements[:, :2])).all()
    quarters = world.measurements[:, 2] / (np.pi / 2)
    assert (quarters == np.rint(quarters)).all()


def test_a_walk_steps_a_meter_and_closes_loops_within_a_meter():
    world = manhattan(600, 1000, extent=12, seed=5)
    gap = np.abs(world.edges[:, 1] - world.edges[:, 0])
    reach = np.hypot(*world.measurements[:, :2].T)
    assert (np.sort(world.edges[gap == 1, 0]) == np.arange(599)).all()
    assert (reach[gap == 1] == 1).all()
    assert (reach[gap > 1] <= 1).all()
    assert len(np.unique(world.edges, axis=0)) == 1000


def test_seeds_make_worlds_and_noise():
    one, same, other = (manhattan(200, 300, extent=8, seed=s) for s in (1, 1, 2))
    assert (one.poses == same.poses).all()
    assert (one.edges == same.edges).all()
    assert (one.poses != other.poses).any()
    noisy = [perturb(one, (0.1, 0.1, 0.1), seed=s).measurements for s in (1, 1, 2)]
    assert (noisy[0] == noisy[1]).all()
    assert (noisy[0] != noisy[2]).any()


def test_impossible_walks_are_refused():
    with pytest.raises(GraphError, match="loop closures"):
        manhattan(10, 1000)
    with pytest.raises(GraphError, match="two nodes"):
        manhattan(1, 0)


def test_noise_has_the_deviations_asked_for_and_sets_the_information():
    world = manhattan(3000, 6000, extent=20)
    sigma = np.array([0.1, 0.2, 0.05])
    noisy = perturb(world, sigma, seed=3)
    error = noisy.measurements - world.measurements
    error[:, 2] = (error[:, 2] + np.pi) % (2 * np.pi) - np.pi
    assert np.allclose(error.std(axis=0), sigma, rtol=4 / np.sqrt(2 * 6000))
    assert np.allclose(error.mean(axis=0), 0, atol=4 * sigma.max() / np.sqrt(6000))
    assert np.allclose(noisy.information, np.diag(1 / sigma**2))
    assert (noisy.poses == world.poses).all()
    assert (np.abs(noisy.measurements[:, 2]) <= np.pi).all()


def test_a_sigma_of_zero_leaves_a_measurement_exact_with_finite_information():
    world = manhattan(100, 150, extent=6)
    noisy = perturb(world, (0, 0, 0.1))
    assert (noisy.measurements[:, :2] == world.measurements[:, :2]).all()
    assert np.allclose(noisy.information[0], np.diag([1e6, 1e6, 100]))


IMPOSSIBLE = [
    *[(0.1, 0.1), (-0.1, 0.1, 0.1), (np.nan, 0, 0)],
    *[(1e200, 1, 1), (1, 1, 1e-200), "abc", ["a", "b", "c"], [(1,), (1, 2), 3], None, 0.1],
]


@pytest.mark.parametrize("sigma", IMPOSSIBLE)
def test_impossible_noise_is_refused(sigma):
    with pytest.raises(GraphError, match="sigma"):
        perturb(manhattan(100, 150, extent=6), sigma)


@pytest.mark.parametrize("seed", [-1, 1.5, "1", None])
def test_impossible_seeds_of_noise_are_refused(seed):
    with pytest.raises(GraphError, match="seed must"):
        perturb(manhattan(100, 150, extent=6), (0.1, 0.1, 0.1), seed=seed)


def test_blocks_longer_than_the_drive_take_no_memory():
    world = city(10, 9, block=10**12)
    assert (world.poses == city(10, 9, block=9).poses).all()


def test_noise_for_2d_is_refused_on_a_3d_graph():
    graph = PoseGraph.from_arrays([(0, 1)], [(1, 0, 0, 0, 0, 0, 1)])
    with pytest.raises(GraphError, match="2D graph has 3 sigmas"):
        perturb(graph, (0.1, 0.1, 0.1))


def test_planar_noise_is_that_of_the_plain_formula():
    world = manhattan(300, 500)
    sigma = np.array([0.1, 0.2, 0.3])
    noise = sigma * np.random.default_rng(7).normal(size=(500, 3))
    plain = world.measurements + noise
    plain[:, 2] = (plain[:, 2] + np.pi) % (2 * np.pi) - np.pi
    assert (perturb(world, sigma, seed=7).measurements == plain).all()


def rotation_vectors(q):
    q = q * np.where(q[:, 3:] < 0, -1, 1)
    sine = np.linalg.norm(q[:, :3], axis=1, keepdims=True)
    return q[:, :3] / sine * 2 * np.arctan2(sine, q[:, 3:])


@pytest.mark.parametrize("sigma", [(0.1, 0.3), (0.1, 0.2, 0.3, 0.02, 0.1, 0.4)])
def test_spatial_noise_has_the_deviations_asked_for_on_each_axis(sigma):
    world = grid(3375)
    noisy = perturb(world, sigma, seed=3)
    m = len(world.edges)
    shift = noisy.measurements[:, :3] - world.measurements[:, :3]
    turn = rotation_vectors(lie.between(world.measurements, noisy.measurements)[:, 3:])
    noise = np.column_stack([shift, turn])
    asked = np.repeat(sigma, 3) if len(sigma) == 2 else np.array(sigma)
    assert np.allclose(noise.std(axis=0), asked, rtol=5 / np.sqrt(2 * m))
    assert np.allclose(noise.mean(axis=0) / asked, 0, atol=5 / np.sqrt(m))
    assert np.allclose(np.corrcoef(noise.T), np.eye(6), atol=5 / np.sqrt(m))
    assert np.allclose(noisy.information, np.diag([1, 1, 1, 4, 4, 4] / asked**2))
    assert (noisy.poses == world.poses).all()


@pytest.mark.parametrize(
    ("name", "sigma"),
    [("manhattan", (0.1, 0.1, 0.05)), ("garage", (0.1, 0.02)), ("torus", (0.05, 0.03))],
)
def test_the_information_fits_the_noise(name, sigma):
    noisy = perturb(WORLDS[name](), sigma, seed=1)
    count = len(noisy.edges) * noisy.dof
    assert chi2_per_edge(noisy).sum() / count == pytest.approx(1, abs=5 * np.sqrt(2 / count))


def test_a_spatial_sigma_of_zero_leaves_a_measurement_exact():
    world = grid(64)
    still = perturb(world, (0.1, 0))
    assert np.abs(lie.between(world.measurements, still.measurements)[:, 3:6]).max() < 1e-15
    assert np.allclose(still.information[0], np.diag([100] * 3 + [4e6] * 3))
    assert (perturb(world, (0, 0.1)).measurements[:, :3] == world.measurements[:, :3]).all()


@pytest.mark.parametrize("sigma", [(0.1,), (0.1,) * 3, (0.1, -0.1), (0.1, np.inf), (0.1,) * 7])
def test_impossible_spatial_noise_is_refused(sigma):
    with pytest.raises(GraphError):
        perturb(grid(27), sigma)


def test_a_perturbed_sphere_is_solved_near_its_truth():
    world = sphere(400)
    result = masat.optimize(masat.initialize(perturb(world, (0.01, 0.01), seed=1), "masat"))
    solved = lie.between(result.poses[0], result.poses)
    apart = solved[:, :3] - lie.between(world.poses[0], world.poses)[:, :3]
    assert np.linalg.norm(apart, axis=1).max() < 0.5


def test_a_perturbed_world_is_solved_near_its_truth():
    world = manhattan(500, 1200, extent=10, seed=2)
    result = masat.optimize(masat.initialize(perturb(world, (0.02, 0.02, 0.01)), "masat"))
    assert np.abs(result.poses[:, :2] - world.poses[:, :2]).max() < 0.3
