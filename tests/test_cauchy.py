import numpy as np
import pytest
from random_graphs import random_graph

import masat
from masat import InitializationError, PoseGraph, lie
from masat.initializers.cauchy import cauchy
from masat.initializers.odometry import odometry
from masat.optimizers.equations import normal_equations
from masat.optimizers.levenberg_marquardt import levenberg_marquardt
from masat.optimizers.losses import robust_cost
from masat.optimizers.reweighting import robust_equations
from masat.optimizers.termination import Termination
from masat.worlds import manhattan, perturb, sphere


def pose(dimension, x):
    return [x, 0, 0] if dimension == 2 else [x, 0, 0, 0, 0, 0, 1]


def cauchy_equations(graph, scale):
    return robust_equations(graph, normal_equations(graph), robust_cost(graph, "cauchy", scale))


@pytest.mark.parametrize("dimension", [2, 3])
def test_weights_of_one_change_nothing(dimension):
    graph = random_graph(dimension, 12, 20, seed=1, noise=0.2)
    plain, weighted = normal_equations(graph), normal_equations(graph)
    chi2 = plain.linearize(graph.poses)
    assert weighted.linearize(graph.poses, np.ones(len(graph.edges))) == chi2
    assert (weighted.rhs() == plain.rhs()).all()
    assert (weighted.multiply(plain.rhs()) == plain.multiply(plain.rhs())).all()


@pytest.mark.parametrize("dimension", [2, 3])
def test_weights_multiply_the_information_and_zero_removes_an_edge(dimension):
    graph = random_graph(dimension, 12, 20, seed=2, noise=0.2)
    weights = np.random.default_rng(0).uniform(0, 2, len(graph.edges))
    weights[3] = 0
    left = weights > 0
    heavier = PoseGraph.from_arrays(
        graph.edges[left],
        graph.measurements[left],
        weights[left, None, None] * graph.information[left],
        ids=graph.ids,
        poses=graph.poses,
        fixed=graph.gauge,
    )
    weighted, expected = normal_equations(graph), normal_equations(heavier)
    assert np.isclose(weighted.linearize(graph.poses, weights), expected.linearize(graph.poses))
    rhs = expected.rhs()
    assert np.allclose(weighted.rhs(), rhs)
    assert np.allclose(weighted.multiply(rhs), expected.multiply(rhs))


def test_there_must_be_a_weight_an_edge():
    graph = random_graph(2, 4, 2, seed=0)
    with pytest.raises(ValueError, match="one weight an edge"):
        normal_equations(graph).linearize(graph.poses, np.ones(1))


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("scale", [0.5, 3])
def test_the_gradient_agrees_with_finite_differences(dimension, scale):
    graph = random_graph(dimension, 6, 8, seed=3, noise=0.3)
    equations = cauchy_equations(graph, scale)
    cost = equations.linearize(graph.poses)
    rhs = equations.rhs()
    assert np.isclose(cost, equations.chi2(graph.poses))
    h = 1e-6
    steps = h * np.eye(len(rhs))
    up, down = (
        np.array([equations.chi2(equations.retract(graph.poses, sign * s)) for s in steps])
        for sign in (1, -1)
    )
    assert np.allclose(-2 * rhs, (up - down) / (2 * h), rtol=1e-5, atol=1e-5 * np.abs(rhs).max())


def test_a_large_scale_is_least_squares():
    graph = random_graph(2, 12, 20, seed=4, noise=0.2)
    cost = cauchy_equations(graph, 1e6).linearize(graph.poses)
    assert np.isclose(cost, normal_equations(graph).chi2(graph.poses))


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("scale", [0.3, 1, 3])
@pytest.mark.parametrize("first", [0, 10 / 3])
def test_of_two_opinions_that_of_odometry_prevails(dimension, scale, first):
    # x / (1 + x^2) = u / (1 + u^2) for x + u = 10/3: x = 1/3, of weights 0.9 and 0.1, or x = 3.
    said = [scale * x for x in (first, 10 / 3 - first)]
    graph = PoseGraph.from_arrays([(0, 1)] * 2, [pose(dimension, x) for x in said])
    start = odometry(graph)
    place = 3 if start.poses[1, 0] > 0 else 1 / 3
    equations = cauchy_equations(start, scale)
    termination = Termination(100, 0.0, 0.0, 1e-9 * scale, 0.0)
    found = levenberg_marquardt(equations, start.poses, termination, lambda _: None)
    expected = [pose(dimension, x) for x in (0, scale * place)]
    assert np.allclose(found.poses, expected, atol=1e-6)
    assert np.allclose(cauchy(graph, scale=scale).poses, expected, atol=0.02 * scale)


@pytest.mark.parametrize(("world", "sigma"), [(manhattan, (0.02,) * 3), (sphere, (0.02, 0.02))])
def test_a_wrong_loop_has_no_say(world, sigma):
    truth = world(300, 560, seed=1)
    noisy = perturb(truth, sigma, seed=1)
    wrong = PoseGraph.from_arrays(
        [*noisy.edges, (10, 290)],
        [*noisy.measurements, lie.identity(truth.dimension)],
        [*noisy.information, noisy.information[0]],
    )

    def error(graph):
        aligned = lie.between(truth.poses[0], truth.poses)[:, : truth.dimension]
        return np.abs(graph.poses[:, : truth.dimension] - aligned).max()

    misled = masat.optimize(masat.initialize(wrong, "masat"), "gauss_newton").graph
    assert error(cauchy(wrong)) < 0.2 * error(misled)


@pytest.mark.parametrize("dimension", [2, 3])
def test_no_iterations_leave_odometry(dimension):
    graph = random_graph(dimension, 30, 30, seed=3)
    chain = odometry(graph.with_root(5)).poses
    assert np.allclose(
        lie.local(chain, cauchy(graph.with_root(5), iterations=0).poses), 0, atol=1e-9
    )


@pytest.mark.parametrize("fixed", [[0, 3], [0, 1, 2, 3]])
def test_fixed_nodes_stay(fixed):
    poses = np.array([(0, 0, 0), (7, 0, 1), (9, 9, 9), (3.3, 0, 0)])
    graph = PoseGraph.from_arrays(
        [(0, 1), (1, 2), (2, 3)], [(1, 0, 0)] * 3, poses=poses, fixed=fixed
    )
    found = cauchy(graph).poses
    assert np.allclose(lie.local(found[fixed], poses[fixed]), 0)
    if len(fixed) == 2:
        assert np.allclose(found[:, 0], [0, 1.1, 2.2, 3.3], atol=0.01)


@pytest.mark.parametrize("change", [{"scale": 0.0}, {"scale": np.nan}, {"iterations": -1}])
def test_what_makes_no_sense_is_refused(change):
    with pytest.raises(InitializationError, match="must"):
        cauchy(random_graph(2, 4, 2, seed=0), **change)


@pytest.mark.parametrize(
    ("name", "optimum"),
    [
        ("2d/input_M3500_g2o.g2o", 137.9129509),
        ("2d/intel.g2o", 45.00469581),
        ("2d/10kHog-man.txt.gz", 171545.4474),
        ("3d/sphere2500.g2o", 727.1496672),
        ("3d/parking-garage.g2o", 1.23869058),
    ],
)
def test_gauss_newton_goes_on_to_the_optimum_of_real_graphs(name, optimum, data_dir):
    result = masat.optimize(cauchy(masat.read(data_dir / name)), "gauss_newton")
    assert result.converged
    assert np.isclose(result.chi2, optimum, rtol=1e-6)
