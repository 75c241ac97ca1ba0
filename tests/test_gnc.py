"""Graduated non-convexity with truncated least squares."""

import numpy as np
import pytest
from random_graphs import with_false_closures

import masat
from masat import StopReason
from masat._core import Loss as ScaledLoss
from masat._core import LossKind
from masat.optimizers import LOSSES, OPTIMIZERS
from masat.worlds import manhattan, perturb

METHODS = list(OPTIMIZERS)


@pytest.mark.parametrize("mu", [1e-4, 0.1, 1.0, 30.0])
def test_the_stages_of_gnc_have_the_weights_of_the_paper(mu):
    # Yang et al. 2020, equations 11 and 14, with r^2 = chi2 and c^2 = 4.
    chi2 = np.geomspace(1e-6, 1e6, 500)
    rho, weight = ScaledLoss(LossKind.TRUNCATED, 2.0, mu)(chi2)
    expected = np.clip(2 / np.sqrt(chi2) * np.sqrt(mu * (mu + 1)) - mu, 0, 1)
    assert np.allclose(weight, expected, rtol=1e-9, atol=1e-12)
    # The cost is that of the weights: w r^2 + mu (1 - w) / (mu + w) c^2.
    assert np.allclose(rho, weight * chi2 + mu * (1 - weight) / (mu + weight) * 4, rtol=1e-9)


def test_the_truncated_loss_is_the_limit_of_the_stages():
    chi2 = np.array([0.1, 3.9, 4.1, 1e4])
    rho, weight = ScaledLoss(LossKind.TRUNCATED, 2.0, 1e9)(chi2)
    assert np.allclose(rho, LOSSES["gnc_tls"](chi2, 2.0)[0])
    assert weight.tolist() == [1, 1, 0, 0]


# Of .8, Gauss-Newton and dogleg end once in a slightly higher minimum, without five true closures.
@pytest.mark.parametrize(
    ("method", "fraction"),
    [(method, fraction) for method in METHODS for fraction in (0.1, 0.5)]
    + [("levenberg_marquardt", 0.8)],
)
@pytest.mark.parametrize("seed", [0, 1])
def test_gnc_rejects_false_closures_and_keeps_true_ones(method, fraction, seed):
    graph, odometry, true = with_false_closures(fraction, seed)
    start = masat.initialize(graph, "odometry")
    result = masat.optimize(start, method, loss="gnc_tls", trusted=odometry)
    assert result.converged
    assert set(result.weights) == {0, 1}
    assert (result.weights[~true] == 0).all()
    # The gate rejects one in 100 by definition.
    assert result.weights[true & ~odometry].mean() > 0.96
    alone = masat.solve(graph.without_edges(np.flatnonzero(~true)))
    assert np.abs(result.poses - alone.poses)[:, :2].max() < 0.15


def test_gnc_where_all_fits_is_least_squares():
    graph = perturb(manhattan(80, 130, seed=2), (0.01,) * 3)
    result = masat.optimize(graph, loss="gnc_tls", scale=100.0)
    assert np.isclose(result.chi2, masat.optimize(graph).chi2)
    assert result.robust_cost == pytest.approx(result.chi2)


def test_a_report_stops_gnc():
    graph, odometry, _ = with_false_closures(0.3, seed=2)
    start = masat.initialize(graph, "odometry")
    result = masat.optimize(start, loss="gnc_tls", trusted=odometry, report=lambda _: True)
    assert result.reason is StopReason.INTERRUPTED
    assert result.iterations == 1
