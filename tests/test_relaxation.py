import numpy as np
import pytest
from random_graphs import random_graph, random_poses

import masat
from masat import PoseGraph, _core, lie
from masat.information import isotropic_weights
from masat.optimality.relaxation import Relaxation, lift
from masat.residuals import chi2_per_edge
from masat.worlds import city, manhattan, perturb, sphere


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
    return relaxed.cost(relaxed.unknowns(graph.poses))


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
        if d == 2:
            moved[:, :d] /= np.linalg.norm(moved[:, :d], axis=(1, 2))[:, None, None]
        else:
            q, r = np.linalg.qr(moved[:, :d].transpose(0, 2, 1))
            moved[:, :d] = (q * np.sign(np.einsum("kii->ki", r))[:, None, :]).transpose(0, 2, 1)
        rise = relaxed.cost(moved) - point.cost
        # Of second order in the step, and not downwards.
        assert -1e-9 < rise < 1e-4 * max(point.cost, 1)


def step(measurement, d):
    """The matrix T of a measurement, by its formula: X_j = T X_i where it fits."""
    out = np.eye(4)
    turn = _core.rotation_matrices(measurement[None])[0]
    if d == 2:
        # Complex numbers, real and imaginary parts a row each: t_j = t_i + z r_i.
        x, y = measurement[:2]
        out[:2, :2], out[2:, :2] = turn, [[x, -y], [y, x]]
    else:
        out[:3, :3], out[3, :3] = turn.T, measurement[:3]
    return out


@pytest.mark.parametrize("dimension", [2, 3])
def test_the_certificate_is_that_of_the_dense_matrix(dimension):
    graph = random_graph(dimension, 6, 12, seed=2, noise=0.4)
    d, n, b = dimension, 6, 4
    relaxed = Relaxation(graph)
    x = relaxed.unknowns(masat.initialize(graph, "chordal").poses)
    units = 1 if d == 2 else 3
    dense = np.zeros((n * b, n * b))
    for k, (i, j) in enumerate(graph.edge_indices):
        # X_j - T X_i, its rows weighted.
        residual = np.zeros((b, n * b))
        residual[:, j * b : j * b + b] = np.eye(b)
        residual[:, i * b : i * b + b] = -step(graph.measurements[k], d)
        # |R|^2 is 2 in 2D, where a unit complex number has 1.
        rotation, translation = relaxed.surrogate.rotation[k], relaxed.surrogate.translation[k]
        weight = [rotation * d / units] * d + [translation] * (b - d)
        dense += residual.T @ np.diag(weight) @ residual
    pulled = (dense @ x.reshape(n * b, -1)).reshape(x.shape)
    for k in range(n):
        multiplier = pulled[k, :d] @ x[k, :d].T
        multiplier = (multiplier + multiplier.T) / 2
        if d == 2:
            multiplier = np.trace(multiplier) * np.eye(2)
        dense[k * b : k * b + d, k * b : k * b + d] -= multiplier
    free = np.arange(b, n * b)  # node 0 is fixed
    s = dense[np.ix_(free, free)]
    linear_term = relaxed._assemble(x)
    onto = np.tile([1.0] * d + [0.0] * (b - d), n - 1)
    for shift in (1e-6, 1e-3, 0.1, 1.0, 10.0):
        positive = np.linalg.eigvalsh(s + shift * np.diag(onto)).min() > 0
        gap = _core.certificate_gap(relaxed._matrix, linear_term, x[1:].copy(), shift, 0.0)
        assert np.isfinite(gap) == positive
        uncertified = _core.uncertified_nodes(relaxed._matrix, linear_term, x[1:].copy(), shift)
        assert (len(uncertified) == 0) == positive
        assert np.all(np.diff(uncertified) > 0)
        # With these fixed, it is positive.
        rest = np.setdiff1d(np.arange(1, n), uncertified + 1)
        left = np.ix_(*[(b * rest[:, None] + np.arange(b)).ravel()] * 2)
        onto_left = np.tile([1.0] * d + [0.0] * (b - d), len(rest))
        assert np.all(np.linalg.eigvalsh(dense[left] + shift * np.diag(onto_left)) > 0)
        if positive:
            g = (dense @ x.reshape(n * b, -1))[free]
            below = np.sum(g * np.linalg.solve(s + shift * np.diag(onto), g))
            assert np.isclose(gap, 4 * units * (n - 1) * shift + below)
        for margin in (1e-4, 0.1):
            lower = s + shift * np.diag(onto) - margin * np.diag(np.abs(np.diag(s)))
            gap = _core.certificate_gap(relaxed._matrix, linear_term, x[1:].copy(), shift, margin)
            assert np.isfinite(gap) == (np.linalg.eigvalsh(lower).min() > 0)
            if np.isfinite(gap):
                g = (dense @ x.reshape(n * b, -1))[free]
                below = np.sum(g * np.linalg.solve(lower, g))
                assert np.isclose(gap, 4 * units * (n - 1) * shift + below)
    with pytest.raises(ValueError, match="margin"):
        _core.certificate_gap(relaxed._matrix, linear_term, x[1:].copy(), shift, -1.0)


def dense(matrix, rows, block):
    """The matrix itself, by its inverse with a damping that makes it positive definite."""
    damping = 1e3
    assert matrix.factorize(np.full(rows, damping)) == -1
    inverse = matrix.solve(np.eye(rows).reshape(rows // block, block, rows)).reshape(rows, rows)
    return np.linalg.inv(inverse) - damping * np.eye(rows)


@pytest.mark.parametrize(("dimension", "kind"), [(2, "numbers"), (3, "numbers"), (3, "matrices")])
def test_the_form_costs_what_its_formula_says(dimension, kind):
    graph = random_graph(dimension, 8, 20, seed=4)
    d, n, m, rng = dimension, 8, len(graph.edges), np.random.default_rng(6)
    fixed = np.zeros(n, bool)
    fixed[[1, 5, 6]] = True
    tau = rng.uniform(1, 3, m)
    root = rng.normal(size=(m, d, d))
    matrices = root + root.transpose(0, 2, 1)
    numbers = rng.uniform(1, 3, m)
    if kind == "numbers":
        matrices = numbers[:, None, None] * np.eye(d)
    i, j = graph.edge_indices.T

    def unknowns():
        poses = random_poses(d, n, rng)
        poses[fixed] = graph.poses[fixed]
        return poses, Relaxation(graph).unknowns(poses)

    def cost(poses):
        turn, r = (_core.rotation_matrices(p) for p in (graph.measurements, poses))
        error = turn.transpose(0, 2, 1) @ r[i].transpose(0, 2, 1) @ r[j]
        ahead = (r[i] @ graph.measurements[:, :d, None])[:, :, 0]
        rotations = 2 * np.einsum("kii->", matrices) - 2 * np.sum(matrices * error)
        return rotations + tau @ np.square(poses[j, :d] - poses[i, :d] - ahead).sum(axis=1)

    order = _core.Elimination(graph.topology, fixed, np.empty(0, np.int32))
    matrix = _core.GraphMatrix(order, 4)
    (at_x, x), (at_y, y) = unknowns(), unknowns()
    weights = numbers if kind == "numbers" else matrices
    f = matrix.assemble_poses(graph.topology, graph.measurements, weights, tau, x)
    f = f.reshape(-1, x.shape[2])
    h = dense(matrix, len(f), 4)

    def form(x):
        own = x[~fixed].reshape(len(f), -1)
        return np.sum(own * (h @ own - 2 * f))

    assert np.isclose(form(x) - form(y), cost(at_x) - cost(at_y), rtol=1e-9, atol=1e-6)
    if kind == "numbers":
        r = _core.rotation_matrices(at_x)
        gap = np.square(r[j] - r[i] @ _core.rotation_matrices(graph.measurements)).sum(axis=(1, 2))
        ahead = (r[i] @ graph.measurements[:, :d, None])[:, :, 0]
        steps = np.square(at_x[j, :d] - at_x[i, :d] - ahead).sum(axis=1)
        assert np.isclose(cost(at_x), numbers @ gap + tau @ steps)
    else:
        with pytest.raises(ValueError, match=r"\(m,\), or \(m, 3, 3\)"):
            matrix.assemble_poses(
                graph.topology, graph.measurements, matrices[:, :1].copy(), tau, x
            )


def test_a_matrix_weight_is_any_information_of_a_quaternion():
    rng = np.random.default_rng(0)
    root, q = rng.normal(size=(3, 3)), random_poses(3, 1, rng)
    w = root @ root.T
    a = np.trace(w) / 8 * np.eye(3) - w / 4
    rotation = _core.rotation_matrices(q)[0]
    vector = q[0, 3:6]
    assert np.isclose(2 * np.trace(a) - 2 * np.sum(a * rotation), vector @ w @ vector)


@pytest.mark.parametrize("make", [manhattan, city, sphere])
def test_minimization_of_an_exact_world_stops_at_rounding(make):
    world = make(1000, seed=0)
    d = world.dimension
    far, z = world.poses.copy(), world.measurements.copy()
    far[:, :d] *= 1e6
    z[:, :d] *= 1e6
    graph = PoseGraph.from_arrays(world.edges, z, ids=world.ids, poses=far)
    relaxed = Relaxation(graph)
    x = relaxed.unknowns(far)
    one, many = (relaxed.minimize(x, decrease=1e-7, damping=1e-2, steps=k) for k in (2, 60))
    assert np.array_equal(one.unknowns, many.unknowns)
    assert many.cost < 1e-12


def lifted_problem(dimension, rank):
    graph = random_graph(dimension, 6, 10, seed=0, noise=0.2)
    relaxed = Relaxation(graph)
    x = relaxed.unknowns(graph.poses)
    if rank > x.shape[2]:
        x = relaxed.lift(x, np.random.default_rng(0))
    return relaxed._matrix, relaxed._assemble(x), x[1:].copy()


@pytest.mark.parametrize(("dimension", "rank"), [(2, 1), (2, 2), (3, 3), (3, 4)])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_what_is_not_finite_is_named_and_changes_nothing(dimension, rank, value):
    matrix, linear_term, x = lifted_problem(dimension, rank)
    for array, node in ((x, 3), (linear_term, 1)):
        array = array.copy()
        array[node, 0, 0] = value
        first = array if array.shape == x.shape and node == 3 else x
        second = array if node == 1 else linear_term
        out, failed = _core.minimize_lifted(matrix, second, 0.0, first, 1e-7, 1.0, 20)
        assert failed == node
        assert np.array_equal(out, first, equal_nan=True)
        gap = _core.certificate_gap(matrix, second, first, 1.0, 0.0)
        assert gap == np.inf
    with pytest.raises(ValueError, match="finite"):
        _core.minimize_lifted(matrix, linear_term, 0.0, x, 1e-7, value, 20)


@pytest.mark.parametrize("dimension", [2, 3])
def test_translations_that_the_edges_do_not_determine_are_named(dimension):
    # Nodes 0 and 1 are joined by an edge whose translation has no weight.
    z = np.tile(lie.identity(dimension), (2, 1))
    graph = PoseGraph.from_arrays([(0, 1), (1, 2)], z, poses=np.vstack([z, z[:1]]), fixed=[0])
    matrix = _core.GraphMatrix(graph.elimination, 4)
    x = Relaxation(graph).unknowns(graph.poses)
    linear_term = matrix.assemble_poses(graph.topology, z, np.ones(2), np.array([0.0, 1]), x)
    moved = x[1:] + 0.1
    out, failed = _core.minimize_lifted(matrix, linear_term, 1.0, moved, 1e-7, 1.0, 20)
    assert failed in (0, 1)
    assert np.array_equal(out, moved)


@pytest.mark.parametrize(("dimension", "rank"), [(2, 1), (2, 2), (3, 3), (3, 4)])
def test_the_block_of_a_lifted_pose_has_its_degrees_of_freedom(dimension, rank):
    # Numbers of a frame less its constraints, and a translation: complex numbers in 2D.
    frame = 2 * rank - 1 if dimension == 2 else 3 * rank - 6
    assert _core.lifted_block_size(rank) == frame + (2 if dimension == 2 else 1) * rank
    with pytest.raises(ValueError, match="ranks are"):
        _core.lifted_block_size(5)


def test_in_2d_the_relaxation_takes_no_reflection_for_a_rotation():
    # At this minimum the matrix of the relaxation with matrices of two rows is indefinite.
    world = manhattan(200, 300, seed=8)
    graph = masat.solve(perturb(world, (0.3, 0.3, 0.3), seed=8)).graph
    relaxed = Relaxation(graph)
    x = relaxed.polish(graph.poses).unknowns
    assert np.isfinite(relaxed.gap(x))
    n = len(graph)
    y, i, j = transposed_poses(relaxed.poses(x)), *graph.edge_indices.T
    dense, turns = np.zeros((n, 3, n, 3)), _core.rotation_matrices(graph.measurements)
    for k in range(len(i)):
        residual = np.zeros((3, n, 3))
        residual[:, j[k]] = np.eye(3)
        residual[:2, i[k], :2] = -turns[k].T
        residual[2, i[k]] = -np.append(graph.measurements[k, :2], 1)
        weight = [relaxed.surrogate.rotation[k]] * 2 + [relaxed.surrogate.translation[k]]
        dense += np.einsum("r,ria,rjb->iajb", weight, residual, residual)
    pulled = np.einsum("iajb,jbc->iac", dense, y)
    for k in range(n):
        multiplier = pulled[k, :2] @ y[k, :2].T
        dense[k, :2, k, :2] -= (multiplier + multiplier.T) / 2
    assert np.linalg.eigvalsh(dense[1:, :, 1:].reshape(3 * n - 3, -1)).min() < -1e-3


def transposed_poses(poses):
    """[R t]' of poses in 2D, (n, 3, 2)."""
    rotations = _core.rotation_matrices(poses).transpose(0, 2, 1)
    return np.concatenate([rotations, poses[:, None, :2]], axis=1)


def test_a_ring_twisted_once_is_untwisted():
    graph = ring(12)
    graph = graph.with_poses(twisted(graph))
    relaxed = Relaxation(graph)
    local = relaxed.polish(graph.poses)
    # Twelve edges, each off by 30 degrees: 2 (1 - cos) of each.
    assert np.isclose(local.cost, 12 * 2 * (1 - np.cos(np.pi / 6)))
    assert relaxed.gap(local.unknowns) == np.inf
    assert not relaxed.plausible(graph.poses)
    top = relaxed.minimize_lifted(local.unknowns, decrease=1e-6, seed=0)
    assert top.unknowns.shape[2] > local.unknowns.shape[2]
    assert top.cost < 1e-6
    assert np.allclose(relaxed.poses(top.unknowns), 0, atol=1e-3)


@pytest.mark.parametrize("make", [manhattan, sphere])
def test_the_same_seed_gives_the_same_poses(make):
    graph = perturb(make(300, seed=0), [0.3] * (3 if make is manhattan else 6), seed=0)
    guess = masat.initialize(graph, "spanning_tree")
    first, second = (lift(guess, seed=4) for _ in range(2))
    assert np.array_equal(first, second)


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
