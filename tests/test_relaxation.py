import numpy as np
import pytest
from random_graphs import random_graph

import masat
from masat import PoseGraph, _core, lie, linear
from masat.optimality import relaxation
from masat.optimality.relaxation import Relaxation
from masat.residuals import chi2_per_edge
from masat.worlds import manhattan, perturb, sphere


def isotropic(graph):
    dof, d = graph.dof, graph.dimension
    information = np.diag([4.0] * d + [9.0] * (dof - d))
    return PoseGraph.from_arrays(
        graph.edges, graph.measurements, information, ids=graph.ids, poses=graph.poses
    )


def ring(nodes):
    """Nodes on one spot that all look the same way, as each measures of the next."""
    edges = [(k, (k + 1) % nodes) for k in range(nodes)]
    return PoseGraph.from_arrays(edges, np.zeros((nodes, 3)))


def twisted(graph):
    """Poses that turn once around a ring: a minimum, but a local one."""
    n = len(graph.ids)
    return np.column_stack([np.zeros((n, 2)), 2 * np.pi * np.arange(n) / n])


def cost_at(graph):
    relaxed = Relaxation(graph)
    return relaxed.cost(relaxed.unknowns(graph.poses, graph.dimension))


def test_the_cost_in_3d_is_chi2_where_information_is_isotropic():
    graph = isotropic(random_graph(3, 10, 20, seed=1, noise=0.3))
    assert np.isclose(cost_at(graph), chi2_per_edge(graph).sum())


def test_the_cost_in_2d_counts_the_cosine_of_a_heading():
    graph = isotropic(random_graph(2, 10, 20, seed=1, noise=0.5))
    i, j = graph.edge_indices.T
    e = lie.local(graph.measurements, lie.between(graph.poses[i], graph.poses[j]))
    expected = (4 * np.square(e[:, :2]).sum(axis=1) + 9 * 2 * (1 - np.cos(e[:, 2]))).sum()
    assert np.isclose(cost_at(graph), expected)


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("extra", [0, 1])
def test_a_minimum_is_critical(dimension, extra):
    graph = random_graph(dimension, 8, 16, seed=3, noise=0.3)
    relaxed = Relaxation(graph)
    x = relaxed.polish(masat.initialize(graph, "chordal").poses).unknowns
    if extra:
        x = relaxed.lift(x, np.random.default_rng(0))
    point = relaxed.minimize(x, decrease=1e-14, damping=1.0)
    d, held = dimension, graph.index(graph.gauge)
    rng = np.random.default_rng(5)
    for _ in range(5):
        step = 1e-4 * rng.normal(size=point.unknowns.shape)
        step[held] = 0
        moved = point.unknowns + step
        q, r = np.linalg.qr(moved[:, :d].transpose(0, 2, 1))
        moved[:, :d] = (q * np.sign(np.einsum("kii->ki", r))[:, None, :]).transpose(0, 2, 1)
        rise = relaxed.cost(moved) - point.cost
        # Of second order in the step, and not downwards.
        assert -1e-9 < rise < 1e-4 * max(point.cost, 1)


@pytest.mark.parametrize("dimension", [2, 3])
def test_the_certificate_is_that_of_the_dense_matrix(dimension):
    graph = random_graph(dimension, 6, 12, seed=2, noise=0.4)
    d, n = dimension, 6
    relaxed = Relaxation(graph)
    x, b = relaxed.unknowns(masat.initialize(graph, "chordal").poses, d), d + 1
    dense = np.zeros((n * b, n * b))
    turns = _core.rotation_matrices(graph.measurements)
    for k, (i, j) in enumerate(graph.edge_indices):
        # X_j - T' X_i, its rows weighted.
        residual = np.zeros((b, n * b))
        residual[:, j * b : j * b + b] = np.eye(b)
        residual[:d, i * b : i * b + d] = -turns[k].T
        residual[d, i * b : i * b + b] = -np.append(graph.measurements[k, :d], 1)
        weight = [relaxed.surrogate.rotation[k]] * d + [relaxed.surrogate.translation[k]]
        dense += residual.T @ np.diag(weight) @ residual
    pulled = (dense @ x.reshape(n * b, -1)).reshape(x.shape)
    for k in range(n):
        multiplier = pulled[k, :d] @ x[k, :d].T
        dense[k * b : k * b + d, k * b : k * b + d] -= (multiplier + multiplier.T) / 2
    free = np.arange(b, n * b)  # node 0 holds still
    s = dense[np.ix_(free, free)]
    forcing = relaxed._assemble(x)
    onto = np.tile([1.0] * d + [0.0], n - 1)
    for shift in (1e-6, 1e-3, 0.1, 1.0, 10.0):
        positive = np.linalg.eigvalsh(s + shift * np.diag(onto)).min() > 0
        gap = _core.certificate_gap(relaxed._matrix, forcing, x[1:].copy(), shift, 0.0)
        assert np.isfinite(gap) == positive
        weak = _core.uncertified_nodes(relaxed._matrix, forcing, x[1:].copy(), shift)
        assert (len(weak) == 0) == positive
        assert np.all(np.diff(weak) > 0)
        # With these held, it is positive.
        rest = np.setdiff1d(np.arange(1, n), weak + 1)
        left = np.ix_(*[(b * rest[:, None] + np.arange(b)).ravel()] * 2)
        onto_left = np.tile([1.0] * d + [0.0], len(rest))
        assert np.all(np.linalg.eigvalsh(dense[left] + shift * np.diag(onto_left)) > 0)
        if positive:
            g = (dense @ x.reshape(n * b, -1))[free]
            below = np.sum(g * np.linalg.solve(s + shift * np.diag(onto), g))
            assert np.isclose(gap, 4 * d * (n - 1) * shift + below)


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("seed", range(4))
def test_no_minimum_lies_below_the_bound(dimension, seed):
    graph = random_graph(dimension, 12, 30, seed=seed, noise={2: 0.8, 3: 0.3}[dimension])
    solution = relaxation.solve(graph, masat.initialize(graph, "spanning_tree").poses)
    assert 0 < solution.bound <= solution.cost
    relaxed, rng = Relaxation(graph), np.random.default_rng(seed)
    for _ in range(30):
        scattered = lie.retract(graph.poses, rng.normal(size=(12, graph.dof)))
        scattered[0] = lie.identity(dimension)
        found = relaxed.polish(scattered).cost
        assert found >= solution.bound * (1 - 1e-9)
        if solution.certified:
            assert found >= solution.cost * (1 - relaxation.TIGHT)


def test_a_ring_twisted_once_is_unravelled():
    graph = ring(12)
    relaxed = Relaxation(graph)
    local = relaxed.polish(twisted(graph))
    # Twelve edges, each off by 30 degrees: 2 (1 - cos) of each.
    assert np.isclose(local.cost, 12 * 2 * (1 - np.cos(np.pi / 6)))
    assert relaxed.gap(local) == np.inf
    assert not relaxed.plausible(twisted(graph))
    solution = relaxation.solve(graph, twisted(graph))
    assert solution.rank > 2
    assert solution.certified
    assert np.allclose(solution.poses, 0, atol=1e-6)


def test_without_lifting_the_local_minimum_stands():
    solution = relaxation.solve(ring(12), twisted(ring(12)), lift=False)
    assert not solution.certified
    assert solution.bound == 0
    assert np.isclose(solution.cost, 12 * 2 * (1 - np.cos(np.pi / 6)))


def test_one_edge_of_great_weight_does_not_hide_a_local_minimum():
    edges = [(k, (k + 1) % 12) for k in range(12)] + [(0, 12)]
    information = np.array([1e-3 * np.eye(3)] * 12 + [1e14 * np.eye(3)])
    graph = PoseGraph.from_arrays(
        edges, np.zeros((13, 3)), information, poses=np.zeros((13, 3)), fixed=[0]
    )
    solution = relaxation.solve(graph, np.vstack([twisted(ring(12)), np.zeros(3)]))
    assert solution.cost < 1e-6 or not solution.certified


def test_what_would_take_too_much_memory_is_not_lifted(monkeypatch):
    monkeypatch.setattr(relaxation, "_MOST_MEMORY", 0)
    assert not relaxation.solve(ring(12), twisted(ring(12))).certified


@pytest.mark.parametrize("make", [manhattan, sphere])
def test_the_same_seed_gives_the_same_poses(make):
    graph = perturb(make(300, seed=0), [0.3] * (3 if make is manhattan else 6), seed=0)
    start = masat.initialize(graph, "spanning_tree").poses
    first, second = (relaxation.solve(graph, start, seed=4) for _ in range(2))
    assert np.array_equal(first.poses, second.poses)
    assert first.bound == second.bound


@pytest.mark.parametrize(("make", "sigma"), [(manhattan, [0.1] * 3), (sphere, [0.05] * 6)])
@pytest.mark.parametrize("method", ["lifted", "auto"])
def test_fixed_nodes_keep_their_poses(make, sigma, method):
    truth = make(200, seed=1)
    noisy = perturb(truth, sigma, seed=1)
    frame = lie.retract(lie.identity(truth.dimension), [30.0] + [0.5] * (len(sigma) - 1))
    away = lie.compose(frame, truth.poses)
    graph = PoseGraph.from_arrays(
        noisy.edges, noisy.measurements, noisy.information, poses=away, fixed=[3, 150]
    )
    guess = masat.initialize(graph, method)
    assert np.array_equal(guess.poses[[3, 150]], graph.poses[[3, 150]])
    assert masat.optimize(guess, "gauss_newton").converged


@pytest.mark.parametrize("method", ["lifted", "auto"])
def test_each_component_is_solved(method):
    one, other = (perturb(manhattan(100, seed=k), [0.1] * 3, seed=k) for k in range(2))
    graph = PoseGraph.from_arrays(
        np.vstack([one.edges, other.edges + 100]),
        np.vstack([one.measurements, other.measurements]),
        np.concatenate([one.information, other.information]),
    )
    with pytest.warns(masat.MasatWarning, match="2 components"):
        both = masat.optimize(masat.initialize(graph, method)).chi2
    alone = [masat.optimize(masat.initialize(g, method)).chi2 for g in (one, other)]
    assert np.isclose(both, sum(alone), rtol=1e-6)


@pytest.mark.parametrize("spread", [1e-6, 1e-9, 1e-12])
def test_the_weights_of_badly_conditioned_information_are_positive(spread):
    q, _ = np.linalg.qr(np.random.default_rng(0).normal(size=(50, 3, 3)))
    block = q @ np.diag([1, spread, spread]) @ q.transpose(0, 2, 1)
    information = np.zeros((50, 6, 6))
    information[:, :3, :3] = information[:, 3:, 3:] = (block + block.transpose(0, 2, 1)) / 2
    edges = [(k, k + 1) for k in range(50)]
    z = np.tile(lie.identity(3), (50, 1))
    try:
        graph = PoseGraph.from_arrays(edges, z, information)
    except masat.InformationError:
        return  # indefinite by rounding, and refused
    weights = isotropic_weights(graph.information)
    true = 3 / (1 + 2 / spread)
    assert np.all(weights.translation > 0)
    if spread > 1e-8:
        assert np.allclose(weights.translation, true, rtol=1e-6)


@pytest.mark.parametrize("sigma", [0.1, 0.25, 0.35])
@pytest.mark.parametrize("method", ["lifted", "auto"])
def test_gauss_newton_ends_no_higher_than_from_the_truth(method, sigma, data_dir, monkeypatch):
    # The study's own check is `masat study run starts`; this is a part of it.
    from masat.study.worlds import load_world

    monkeypatch.setenv("MASAT_DATASETS", str(data_dir))
    truth = load_world("Manhattan3500")
    for seed in range(2):
        graph = perturb(truth, [sigma] * 3, seed=seed)
        limits = {"max_iterations": 50, "relative_tolerance": 1e-6}
        control = masat.optimize(graph.with_poses(truth.poses), "gauss_newton", **limits)
        result = masat.optimize(masat.initialize(graph, method), "gauss_newton", **limits)
        assert result.converged
        assert result.chi2 <= control.chi2 * (1 + 1e-6)
