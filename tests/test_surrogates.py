"""Surrogates of chi2: what they cost, where they touch chi2, and that they exceed it nowhere."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from random_graphs import random_graph
from test_relaxation import dense

import masat
from masat import OptimizationError, PoseGraph, _core, lie
from masat.optimality.relaxation import Relaxation
from masat.optimality.surrogates import chordal_surrogate, tangent_surrogate
from masat.residuals import chi2_per_edge, residuals

SCALES = (0.01, 0.1, 1.0, 3.0)


def costs(graph, surrogate, poses):
    """The definition: 2 tr(A) - 2 <A, R' R_i' R_j> + tau |t_j - t_i - R_i t|^2 of each edge."""
    d, (i, j) = graph.dimension, graph.edge_indices.T
    z, a, tau, _ = surrogate
    turn, measured = _core.rotation_matrices(poses), _core.rotation_matrices(z)
    error = measured.transpose(0, 2, 1) @ turn[i].transpose(0, 2, 1) @ turn[j]
    if a.ndim == 1:
        a = a[:, None, None] * np.eye(d)
    t = poses[:, :d]
    gone = t[j] - t[i] - np.einsum("kij,kj->ki", turn[i], z[:, :d])
    rotation = 2 * np.einsum("kii->k", a) - 2 * np.einsum("kij,kij->k", a, error)
    return rotation + tau * np.square(gone).sum(axis=1)


def with_information(graph, kind, rng):
    dof, d, m = graph.dof, graph.dimension, len(graph.edges)
    half = rng.normal(size=(m, dof, dof))
    w = half @ half.transpose(0, 2, 1) + 0.3 * np.eye(dof)
    if kind != "coupled":
        w[:, :d, d:] = w[:, d:, :d] = 0
    if kind == "isotropic":
        w = np.zeros((m, dof, dof))
        w[:, range(d), range(d)] = rng.uniform(1, 9, m)[:, None]
        w[:, range(d, dof), range(d, dof)] = rng.uniform(1, 9, m)[:, None]
    return PoseGraph.from_arrays(graph.edges, graph.measurements, w, poses=graph.poses)


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("kind", ["isotropic", "uncoupled", "coupled"])
@given(seed=st.integers(0, 10**6))
def test_the_tangent_surrogate_touches_chi2_and_exceeds_it_nowhere(dimension, kind, seed):
    rng = np.random.default_rng(seed)
    graph = with_information(random_graph(dimension, 6, 9, seed=seed, noise=0.3), kind, rng)
    surrogate = tangent_surrogate(graph, graph.poses)
    chi2 = chi2_per_edge(graph).sum()
    at_touch = costs(graph, surrogate, graph.poses).sum()
    assert 0 <= surrogate.deficit <= chi2 * (1 + 1e-9)
    # At these poses it is chi2 less the deficit: that determines the constant.
    constant = chi2 - surrogate.deficit - at_touch
    magnitude = 1 + chi2 + abs(at_touch)
    for scale in SCALES:
        poses = lie.retract(graph.poses, rng.normal(size=(6, graph.dof)) * scale)
        elsewhere = costs(graph, surrogate, poses).sum() + constant
        assert elsewhere <= chi2_per_edge(graph, poses).sum() + 1e-9 * magnitude


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("kind", ["isotropic", "uncoupled", "coupled"])
def test_the_tangent_surrogate_has_the_gradient_of_chi2(dimension, kind):
    rng = np.random.default_rng(3)
    graph = with_information(random_graph(dimension, 6, 9, seed=7, noise=0.2), kind, rng)
    surrogate = tangent_surrogate(graph, graph.poses)
    assert surrogate.deficit == 0

    def difference(step):
        up, down = (lie.retract(graph.poses, sign * step) for sign in (1, -1))
        return np.array(
            [
                costs(graph, surrogate, up).sum() - costs(graph, surrogate, down).sum(),
                chi2_per_edge(graph, up).sum() - chi2_per_edge(graph, down).sum(),
            ]
        )

    for _ in range(10):
        mine, exact = difference(1e-6 * rng.normal(size=(6, graph.dof)))
        assert np.isclose(mine, exact, rtol=1e-5, atol=1e-9)


def test_a_heading_residual_of_half_a_turn_leaves_a_deficit():
    graph = PoseGraph.from_arrays(
        [(0, 1)], [(0, 0, np.pi)], np.diag([1.0, 1, 4]), poses=np.zeros((2, 3))
    )
    surrogate = tangent_surrogate(graph, graph.poses)
    assert 0 < surrogate.deficit < 4 * np.pi**2
    for heading in np.linspace(-np.pi, np.pi, 50):
        poses = np.array([[0, 0, 0], [0, 0, heading]])
        below = costs(graph, surrogate, poses).sum() - costs(graph, surrogate, graph.poses).sum()
        assert 4 * np.pi**2 - surrogate.deficit + below <= chi2_per_edge(graph, poses)[0] + 1e-9


def test_in_3d_any_rotation_information_is_represented_exactly():
    rng = np.random.default_rng(0)
    graph = random_graph(3, 6, 9, seed=1, noise=0.5)
    half = rng.normal(size=(len(graph.edges), 3, 3))
    w = np.tile(np.eye(6), (len(graph.edges), 1, 1))
    # No eigenvalue above the sum of the two others.
    w[:, 3:, 3:] = half @ half.transpose(0, 2, 1) * 0.05 + np.eye(3)
    graph = PoseGraph.from_arrays(graph.edges, graph.measurements, w, poses=graph.poses)
    surrogate = tangent_surrogate(graph, graph.poses)
    for _ in range(5):
        poses = lie.retract(graph.poses, rng.normal(size=(6, 6)))
        assert np.allclose(costs(graph, surrogate, poses), chi2_per_edge(graph, poses))


def test_the_chordal_surrogate_matches_chi2_for_small_residuals():
    for dimension in (2, 3):
        graph = random_graph(dimension, 6, 9, seed=2, noise=1e-4)
        rng = np.random.default_rng(1)
        graph = with_information(graph, "isotropic", rng)
        assert np.abs(residuals(graph)).max() < 1e-3
        found = costs(graph, chordal_surrogate(graph), graph.poses)
        assert np.allclose(found, chi2_per_edge(graph), rtol=1e-5)


def test_information_that_is_singular_to_rounding_is_named():
    w = np.eye(3)
    w[:2, :2] = [[1, 1 - 1e-15], [1 - 1e-15, 1]]
    graph = PoseGraph.from_arrays([(4, 7)], [(1, 0, 0)], w, poses=np.zeros((2, 3)))
    with pytest.raises(OptimizationError, match="4 -> 7 is singular to rounding"):
        tangent_surrogate(graph, graph.poses)
    assert masat.certify(graph).status != "optimal"


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("seed", range(5))
def test_a_sensor_off_its_node_has_a_surrogate_too(dimension, seed):
    rng = np.random.default_rng(seed)
    graph = random_graph(dimension, 6, 9, seed=seed, noise=0.3)
    offsets, priors = (
        lie.retract(np.tile(lie.identity(dimension), (4, 1)), rng.normal(size=(4, graph.dof)) * 0.4)
        for _ in range(2)
    )
    at = lie.compose(lie.compose(graph.poses[:4], offsets), priors)
    weights = np.full(graph.dof, 3.0)
    weights[dimension:] = 2.0
    graph = graph.with_fixed([]).with_priors(
        masat.pose_priors(graph.ids[:4], at, np.diag(weights), offset=offsets)
    )
    assembled = masat.assembly.assemble(graph).graph
    relaxation = Relaxation(assembled, tangent_surrogate(assembled, assembled.poses))
    deficit = relaxation.surrogate.deficit

    def surrogate(poses):
        return relaxation.cost(relaxation.unknowns(poses))

    def matrix_form(poses):
        x = relaxation.unknowns(poses)
        free = assembled.elimination.free_nodes()
        own = x[free].reshape(-1, x.shape[2])
        f = relaxation._assemble(x).reshape(-1, x.shape[2])
        h = dense(relaxation._matrix, len(f), 4)
        return np.sum(own * (h @ own - 2 * f))

    touched, form = surrogate(assembled.poses), matrix_form(assembled.poses)
    for scale in SCALES:
        poses = assembled.poses.copy()
        step = rng.normal(size=(6, graph.dof)) * scale
        poses[:6] = lie.retract(poses[:6], step)
        more = surrogate(poses) - touched
        assert np.isclose(matrix_form(poses) - form, more, rtol=1e-8, atol=1e-7)
        rise = assembled.with_poses(poses).chi2 - assembled.chi2
        assert more <= rise + deficit + 1e-9 * (1 + abs(touched))
