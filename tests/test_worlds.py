import numpy as np
import pytest

import masat
from masat import GraphError, PoseGraph
from masat.optimizers.equations import edge_chi2
from masat.worlds import manhattan, perturb


def test_the_truth_of_a_manhattan_is_consistent_and_on_the_grid():
    world = manhattan(600, 1000, extent=12, seed=5)
    assert (len(world.ids), len(world.edges)) == (600, 1000)
    assert edge_chi2(world).sum() < 1e-25
    places = world.poses[:, :2]
    assert (places == np.rint(places)).all()
    assert (np.ptp(places, axis=0) <= 12).all()
    assert (world.measurements[:, :2] == np.rint(world.measurements[:, :2])).all()
    quarters = world.measurements[:, 2] / (np.pi / 2)
    assert (quarters == np.rint(quarters)).all()


def test_a_walk_steps_a_metre_and_closes_loops_within_a_metre():
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


@pytest.mark.parametrize("sigma", [(0.1, 0.1), (-0.1, 0.1, 0.1), (np.nan, 0, 0)])
def test_impossible_noise_is_refused(sigma):
    with pytest.raises(GraphError):
        perturb(manhattan(100, 150, extent=6), sigma)


def test_planar_noise_is_refused_on_a_spatial_graph():
    spatial = PoseGraph.from_arrays([(0, 1)], [(1, 0, 0, 0, 0, 0, 1)])
    with pytest.raises(GraphError, match="planar"):
        perturb(spatial, (0.1, 0.1, 0.1))


def test_a_perturbed_world_is_solved_near_its_truth():
    world = manhattan(500, 1200, extent=10, seed=2)
    result = masat.optimize(masat.initialize(perturb(world, (0.02, 0.02, 0.01))))
    assert np.abs(result.poses[:, :2] - world.poses[:, :2]).max() < 0.3
