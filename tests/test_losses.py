"""Losses: their formulas, and what an optimizer makes of them."""

import json

import numpy as np
import pytest
from click.testing import CliRunner
from random_graphs import random_graph, with_false_closures

import masat
from masat import OptimizationError, PoseGraph, Result, StopReason
from masat.cli import cli
from masat.optimizers import LOSSES, OPTIMIZERS
from masat.optimizers.equations import normal_equations
from masat.optimizers.losses import default_scale, robust_cost
from masat.optimizers.reweighting import robust_equations
from masat.residuals import chi2_per_edge
from masat.worlds import manhattan, perturb

METHODS = list(OPTIMIZERS)
SMOOTH = [name for name in LOSSES if name != "gnc_tls"]
# rho / scale^2 far out, at u = 1e8; the square root and the logarithm have no limit.
FAR_OUT = {
    "cauchy": np.log(1e8),
    "geman_mcclure": 1,
    "huber": 2e4 - 1,
    "tukey": 1 / 3,
    "dcs": 3,
    "gnc_tls": 1,
}


def own_cauchy(chi2):
    """What a user may write."""
    return 4 * np.log1p(chi2 / 4), 1 / (1 + chi2 / 4)


def pair(*x, dimension=2):
    """Two nodes, and a measurement of the step between them for each x."""
    rest = [0] * 2 if dimension == 2 else [0] * 5 + [1]
    return PoseGraph.from_arrays(
        [(0, 1)] * len(x), [[v, *rest] for v in x], poses=[[0, *rest], [x[0], *rest]]
    )


@pytest.mark.parametrize("scale", [0.7, 3.0])
@pytest.mark.parametrize("name", LOSSES)
def test_the_weight_is_the_derivative_of_rho(name, scale):
    chi2 = scale**2 * np.array([0.01, 0.3, 0.9, 0.99, 1.01, 1.2, 3, 50])
    h = 1e-6 * scale**2
    rho, weight = LOSSES[name](chi2, scale)
    slope = (LOSSES[name](chi2 + h, scale)[0] - LOSSES[name](chi2 - h, scale)[0]) / (2 * h)
    assert np.allclose(weight, slope, rtol=1e-6, atol=1e-8)
    assert (rho <= chi2).all()


@pytest.mark.parametrize("name", LOSSES)
def test_small_residuals_are_squared_and_large_ones_are_not(name):
    chi2 = np.array([0, 1e-8])
    rho, weight = LOSSES[name](chi2, 2.0)
    assert np.allclose(rho, chi2, atol=1e-15)
    assert np.allclose(weight, 1)
    rho, weight = LOSSES[name](np.array([4e8]), 2.0)
    assert np.isclose(rho[0] / 4, FAR_OUT[name])
    assert 0 <= weight[0] <= 1e-4


@pytest.mark.parametrize("name", LOSSES)
def test_the_weight_never_grows_with_chi2(name):
    weight = LOSSES[name](np.linspace(0, 40, 2001), 2.0)[1]
    assert (np.diff(weight) <= 0).all()
    assert weight.min() >= 0


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("loss", [*SMOOTH, own_cauchy])
def test_the_gradient_agrees_with_finite_differences(dimension, loss):
    graph = random_graph(dimension, 6, 8, seed=3, noise=0.3)
    trusted = np.arange(len(graph.edges)) % 3 == 0
    cost = robust_cost(graph, loss, None, trusted)
    equations = robust_equations(graph, normal_equations(graph), cost)
    value = equations.linearize(graph.poses)
    rhs = equations.rhs()
    assert np.isclose(value, equations.chi2(graph.poses))
    assert np.isclose(value, cost(chi2_per_edge(graph))[0].sum())
    h = 1e-6
    up, down = (
        np.array(
            [equations.chi2(equations.retract(graph.poses, s)) for s in sign * h * np.eye(len(rhs))]
        )
        for sign in (1, -1)
    )
    assert np.allclose(-2 * rhs, (up - down) / (2 * h), rtol=1e-5, atol=1e-5 * np.abs(rhs).max())


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_loss_of_the_core_and_the_same_in_python_set_the_same_system(dimension):
    graph = random_graph(dimension, 12, 20, seed=1, noise=0.3)
    trusted = np.arange(len(graph.edges)) < 5
    both = [
        robust_equations(graph, normal_equations(graph), robust_cost(graph, *given, trusted))
        for given in (("cauchy", 2.0), (own_cauchy, None))
    ]
    core, python = both
    assert np.isclose(core.linearize(graph.poses), python.linearize(graph.poses))
    assert np.allclose(core.rhs(), python.rhs())
    assert np.allclose(core.diagonal(), python.diagonal())


def test_a_loss_in_python_is_asked_once_for_the_same_poses():
    graph = random_graph(2, 12, 20, seed=1, noise=0.1)
    calls = []

    def counted(chi2):
        calls.append(chi2)
        return own_cauchy(chi2)

    equations = robust_equations(graph, normal_equations(graph), robust_cost(graph, counted))
    assert equations.chi2(graph.poses) == equations.linearize(graph.poses)
    assert len(calls) == 1


@pytest.mark.parametrize("method", METHODS)
def test_three_opinions_of_which_two_agree(method):
    # Huber: 2 x = scale, since the third edge counts scale / |r| times r. The others reject it.
    graph = pair(0.0, 0.0, 100.0)

    def x(loss):
        result = masat.optimize(graph, method, loss=loss, scale=2.0)
        assert result.converged
        return result.poses[1, 0]

    assert np.isclose(masat.optimize(graph, method).poses[1, 0], 100 / 3)
    assert np.isclose(x("huber"), 1.0, atol=1e-4)
    for loss in ("tukey", "gnc_tls"):
        assert np.isclose(x(loss), 0, atol=1e-12)
    # 2 x = (100 - x) / (1 + (100 - x)^2 / 4): about 4 / 200.
    assert np.isclose(x("cauchy"), 0.02, atol=1e-3)
    assert np.isclose(x("geman_mcclure"), 0, atol=1e-4)
    assert np.isclose(x("dcs"), 0, atol=2e-4)


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("loss", [*LOSSES, own_cauchy])
def test_the_trusted_edge_of_two_prevails(dimension, loss):
    graph = pair(50.0, 0.0, dimension=dimension)
    result = masat.optimize(graph, loss=loss, trusted=np.array([False, True]))
    # The gradient is zero: x = weight (50 - x).
    x, weight = result.poses[1, 0], result.weights[0]
    assert np.isclose(x, weight * (50 - x), rtol=1e-3, atol=1e-9)
    assert 0 <= weight < 0.1
    assert result.weights[1] == 1


@pytest.mark.parametrize("loss", LOSSES)
def test_all_trusted_is_least_squares(loss):
    graph = masat.initialize(perturb(manhattan(80, 130, seed=2), (0.1,) * 3), "chordal")
    plain = masat.optimize(graph)
    result = masat.optimize(graph, loss=loss, trusted=np.ones(len(graph.edges), bool))
    assert np.isclose(result.chi2, plain.chi2, rtol=1e-9)
    assert np.isclose(result.robust_cost, plain.chi2, rtol=1e-9)
    assert (result.weights == 1).all()


@pytest.mark.parametrize("method", ["levenberg_marquardt", "dogleg"])
@pytest.mark.parametrize("loss", [*SMOOTH, own_cauchy])
def test_the_cost_never_rises(method, loss):
    graph, odometry, _ = with_false_closures(0.3, seed=1)
    start = masat.initialize(graph, "odometry")
    result = masat.optimize(start, method, loss=loss, trusted=odometry)
    costs = [iteration.chi2 for iteration in result.history]
    assert len(costs) > 1
    assert (np.diff(costs) <= 0).all()
    assert costs[0] < robust_cost(graph, loss, None, odometry)(chi2_per_edge(start))[0].sum()
    assert np.isclose(costs[-1], result.robust_cost, rtol=1e-9)


@pytest.mark.parametrize("loss", [*LOSSES, own_cauchy])
def test_the_result_tells_chi2_cost_and_weights(loss):
    graph, odometry, _ = with_false_closures(0.3, seed=2)
    start = masat.initialize(graph, "odometry")
    result = masat.optimize(start, loss=loss, trusted=odometry)
    per_edge = chi2_per_edge(result.graph)
    rho, weight = robust_cost(graph, loss, None, odometry)(per_edge)
    assert result.loss == (loss if isinstance(loss, str) else "own_cauchy")
    assert np.isclose(result.initial_chi2, start.chi2)
    assert np.isclose(result.chi2, per_edge.sum())
    assert np.isclose(result.robust_cost, rho.sum())
    assert (result.weights == weight).all()
    assert not result.weights.flags.writeable
    assert (result.weights[odometry] == 1).all()


@pytest.mark.parametrize("method", METHODS)
def test_a_node_whose_edges_have_no_weight_is_named(method):
    graph = pair(0.0).with_poses(np.array([[0, 0, 0], [100.0, 0, 0]]))
    result = masat.optimize(graph, method, loss="tukey")
    assert result.reason is StopReason.SINGULAR
    assert "no weight to the edges around node 1; trust odometry" in result.message


@pytest.mark.parametrize("loss", LOSSES)
def test_results_are_deterministic(loss):
    graph, odometry, _ = with_false_closures(0.3, seed=2)
    start = masat.initialize(graph, "odometry")
    runs = [
        masat.optimize(start, loss=loss, trusted=odometry, threads=threads) for threads in (1, 1, 2)
    ]
    for other in runs[1:]:
        assert (other.poses == runs[0].poses).all()
        assert (other.weights == runs[0].weights).all()


def test_default_scales_are_the_99_percent_gate():
    random = np.random.default_rng(0)
    for dof in (3, 6):
        drawn = np.square(random.normal(size=(200_000, dof))).sum(axis=1)
        assert np.isclose(np.mean(drawn > default_scale(dof) ** 2), 0.01, atol=0.001)


def no_arrays(chi2):
    return None


def one_number(chi2):
    return chi2.sum(), chi2


def negative(chi2):
    return chi2, -chi2


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"loss": "welsch"}, "unknown loss 'welsch'; known: cauchy, .*gnc_tls, or a function"),
        ({"loss": 3}, "a name or a function"),
        ({"loss": "huber", "scale": 0}, "must be positive"),
        ({"loss": "huber", "scale": -1.0}, "must be positive"),
        ({"loss": "huber", "scale": np.nan}, "must be positive"),
        ({"loss": "huber", "scale": "wide"}, "must be a number"),
        ({"loss": own_cauchy, "scale": 1.0}, "has its scale inside"),
        ({"loss": "huber", "trusted": np.ones(2, bool)}, r"one entry an edge, \(3,\), got bool"),
        ({"loss": "huber", "trusted": [0, 1, 2]}, "boolean mask"),
        ({"scale": 1.0}, "without a loss"),
        ({"trusted": np.ones(3, bool)}, "without a loss"),
        ({"loss": no_arrays}, "no_arrays must return two arrays"),
        ({"loss": one_number}, "one cost and one weight an edge"),
        ({"loss": negative}, "negative must return finite costs and weights of at least 0"),
    ],
)
def test_what_makes_no_sense_is_refused(wrong, message):
    with pytest.raises(OptimizationError, match=message):
        masat.optimize(pair(0.0, 1.0, 2.0), **wrong)


def test_there_is_no_certificate_of_a_robust_cost():
    with pytest.raises(OptimizationError, match="no certificate for a robust cost"):
        masat.solve(pair(0.0, 1.0), certify=True, loss="cauchy")


def test_results_with_weights_are_saved(tmp_path):
    graph, odometry, _ = with_false_closures(0.3, seed=2)
    result = masat.solve(graph, init="odometry", loss="dcs", scale=3.0, trusted=odometry)
    assert result.weights[odometry].min() == 1
    result.save(tmp_path / "result.npz")
    loaded = Result.load(tmp_path / "result.npz")
    assert loaded.loss == "dcs"
    assert loaded.robust_cost == result.robust_cost
    assert (loaded.weights == result.weights).all()
    masat.optimize(graph.with_poses(result.poses)).save(tmp_path / "plain.npz")
    plain = Result.load(tmp_path / "plain.npz")
    assert (plain.loss, plain.robust_cost, plain.weights) == (None, None, None)


def test_the_command_line_takes_a_loss(tmp_path):
    graph, _, true = with_false_closures(0.1, seed=2)
    path = str(tmp_path / "graph.g2o")
    masat.write(masat.initialize(graph, "odometry"), path)
    command = ["solve", path, "--init", "given", "--loss", "geman_mcclure", "--loss-scale", "4"]
    printed = CliRunner().invoke(cli, command)
    assert printed.exit_code == 0
    assert "robust cost" in printed.stdout
    said = json.loads(CliRunner().invoke(cli, [*command, "--json"]).stdout)
    assert said["loss"] == "geman_mcclure"
    assert said["robust_cost"] < said["chi2"]
    assert sum(said["weights"].values()) == len(true)
    assert said["certificate"] is None
    refused = CliRunner().invoke(cli, [*command, "--certify"])
    assert refused.exit_code != 0
    assert "no certificate for a robust cost" in str(refused.exception)
