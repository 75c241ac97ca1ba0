import numpy as np
import pytest
from random_graphs import random_graph

import masat
from masat import InitializationError, PoseGraph, lie
from masat.initializers.toro import toro
from masat.worlds import manhattan, perturb, sphere


def planar(x, y, theta):
    return [x, y, theta]


def spatial(x, y, theta):
    """The same in a plane of space, turned about an axis askew."""
    axis = np.array([1, 2, 2]) / 3
    return [x, 0, y, *(np.sin(theta / 2) * axis), np.cos(theta / 2)]


PLANES = pytest.mark.parametrize("pose", [planar, spatial])


def chi2(graph):
    return masat.optimize(graph, max_iterations=0).initial_chi2


@PLANES
def test_two_nodes_share_the_error_of_a_triangle(pose):
    # The tree is 0-1 and 0-2; the loop comes last and lies on both equally.
    edges = [(0, 1), (0, 2), (1, 2)]
    turned = PoseGraph.from_arrays(edges, [pose(0, 0, 0), pose(0, 0, 0), pose(0, 0, 0.2)])
    expected = [pose(0, 0, 0), pose(0, 0, -0.1), pose(0, 0, 0.1)]
    assert np.allclose(toro(turned, sweeps=1).poses, expected)
    shifted = PoseGraph.from_arrays(edges, [pose(1, 0, 0), pose(0, 1, 0), pose(-1, 1.2, 0)])
    expected = [pose(0, 0, 0), pose(1, -0.1, 0), pose(0, 1.1, 0)]
    assert np.allclose(toro(shifted, sweeps=1).poses, expected)


@PLANES
def test_a_square_with_an_error_of_angle(pose):
    # The tree is 0-1-2 and 0-3. The loop 2-3 gives a third of its error to each node; then 1-2,
    # whose path begins deeper, takes back half of its own. In the end each edge has a quarter.
    graph = PoseGraph.from_arrays(
        [(0, 1), (1, 2), (3, 0), (2, 3)], [pose(0, 0, t) for t in (0, 0, 0, 0.6)]
    )
    expected = [pose(0, 0, t) for t in (0, -0.2, -0.3, 0.2)]
    assert np.allclose(toro(graph, sweeps=1).poses, expected)
    expected = [pose(0, 0, t) for t in (0, -0.15, -0.3, 0.15)]
    assert np.allclose(toro(graph, sweeps=2000).poses, expected, atol=2e-3)


def test_a_turn_takes_along_what_lies_behind_it():
    # As the triangle, with 3 behind 2.
    graph = PoseGraph.from_arrays(
        [(0, 1), (0, 2), (1, 2), (2, 3)], [(0, 0, 0), (0, 0, 0), (0, 0, 0.2), (5, 0, 0)]
    )
    expected = (5 * np.cos(0.1), 5 * np.sin(0.1), 0.1)
    assert np.allclose(toro(graph, sweeps=1).poses[3], expected)


@pytest.mark.parametrize(
    ("error", "strong", "slacks"),
    # A node yields by 1 / the weight on it: 1 / (w + 1), and 1 / (1 + 1).
    [((0, 0, 0.2), (1, 1, 3), (1 / 4, 1 / 2)), ((0.2, 0, 0), (5, 9, 1), (1 / 8, 1 / 2))],
)
def test_strong_edges_yield_less(error, strong, slacks):
    graph = PoseGraph.from_arrays(
        [(0, 1), (0, 2), (1, 2)],
        [(0, 0, 0), (0, 0, 0), error],
        [np.diag(strong), np.eye(3), np.eye(3)],
    )
    first, second = np.outer(slacks, error)
    assert np.allclose(toro(graph, sweeps=1).poses, [(0, 0, 0), -first, second])


@PLANES
def test_between_two_fixed_nodes_the_free_ones_give_way(pose):
    graph = PoseGraph.from_arrays(
        [(0, 1), (3, 2), (1, 2)],
        [pose(1, 0, 0), pose(-1, 0, 0), pose(1, 0, 0)],
        poses=[pose(x, 0, 0) for x in (0, 9, 9, 3.3)],
        fixed=[0, 3],
    )
    for sweeps, places in [(0, (1, 2.3)), (1, (1.15, 2.15)), (2000, (1.1, 2.2))]:
        expected = [pose(x, 0, 0) for x in (0, *places, 3.3)]
        assert np.allclose(toro(graph, sweeps=sweeps).poses, expected, atol=1e-3)


def test_fixed_nodes_with_an_edge_between_them_stay():
    graph = PoseGraph.from_arrays(
        [(0, 1), (1, 2)], [(1, 0, 0)] * 2, poses=[(0, 0, 0), (7, 0, 1), (9, 9, 9)], fixed=[0, 1]
    )
    expected = [(0, 0, 0), (7, 0, 1), (7 + np.cos(1), np.sin(1), 1)]
    assert np.allclose(toro(graph).poses, expected)


@pytest.mark.parametrize("dimension", [2, 3])
def test_no_sweeps_leave_the_spanning_tree(dimension):
    graph = random_graph(dimension, 50, 50, seed=3)
    tree = masat.initialize(graph, "spanning_tree").poses
    assert np.allclose(lie.local(tree, toro(graph, sweeps=0).poses), 0, atol=1e-9)


@pytest.mark.parametrize("dimension", [2, 3])
def test_without_noise_many_sweeps_stay_at_the_truth(dimension):
    graph = random_graph(dimension, 100, 200, seed=4, noise=0.0)
    truth = lie.between(graph.poses[0], graph.poses)
    assert np.allclose(lie.local(truth, toro(graph, sweeps=300).poses), 0, atol=1e-10)


@pytest.mark.parametrize(
    ("world", "sigma"), [(manhattan, (0.05, 0.05, 0.05)), (sphere, (0.05, 0.05))]
)
def test_chi2_falls_far_below_that_of_the_tree_and_of_masat(world, sigma):
    graph = perturb(world(1000, 1900, seed=1), sigma, seed=1)
    guess = chi2(toro(graph))
    assert guess < 0.02 * chi2(masat.initialize(graph, "spanning_tree"))
    assert guess < chi2(masat.initialize(graph, "masat"))
    assert chi2(toro(graph, sweeps=100)) < guess


def test_a_negative_number_of_sweeps_is_refused():
    with pytest.raises(InitializationError, match="-1"):
        toro(random_graph(2, 4, 2, seed=0), sweeps=-1)


@pytest.mark.parametrize(
    ("name", "optimum"),
    [
        ("2d/input_M3500_g2o.g2o", 137.9129509),
        ("2d/intel.g2o", 45.00469581),
        ("2d/MIT.g2o", 41.1632688),
        ("3d/sphere2500.g2o", 727.1496672),
        ("3d/parking-garage.g2o", 1.23869058),
    ],
)
def test_gauss_newton_goes_on_to_the_optimum_of_real_graphs(name, optimum, data_dir):
    graph = masat.read(data_dir / name)
    guess = toro(graph)
    assert chi2(guess) < 0.1 * chi2(masat.initialize(graph, "spanning_tree"))
    result = masat.optimize(guess, "gauss_newton")
    assert result.converged
    assert np.isclose(result.chi2, optimum, rtol=1e-6)
