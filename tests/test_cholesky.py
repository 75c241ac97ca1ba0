import os
import signal
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from random_graphs import random_graph, random_poses

from masat import PoseGraph, lie
from masat._core import Elimination, GraphMatrix, NormalEquations, Topology
from masat.worlds import perturb, sphere

NO_ORDER = np.empty(0, np.int32)
TASKS = Path("/proc/self/task")
needs_timers = pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="needs POSIX timers")


def equations_of(graph, threads=1):
    fixed = np.zeros(len(graph.ids), bool)
    fixed[0] = True
    order = Elimination(graph.topology, fixed, NO_ORDER)
    return NormalEquations(graph.topology, order, graph.measurements, graph.information, threads)


def dense(graph, poses):
    """H and the right-hand side, edge by edge from numerical derivatives."""
    dof, n = lie.DOF[graph.dimension], len(graph.ids)
    h = np.zeros((n * dof, n * dof))
    rhs = np.zeros(n * dof)
    step = 1e-6 * np.eye(dof)
    for (a, b), z, w in zip(graph.edge_indices, graph.measurements, graph.information, strict=True):

        def error(da, db, a=a, b=b, z=z):
            moved = lie.retract(poses[a], da), lie.retract(poses[b], db)
            return lie.local(z, lie.between(*moved))

        still = np.zeros((dof, dof))
        j = np.hstack(
            [
                (error(step, still) - error(-step, still)).T / 2e-6,
                (error(still, step) - error(still, -step)).T / 2e-6,
            ]
        )
        index = np.concatenate([a * dof + np.arange(dof), b * dof + np.arange(dof)])
        h[np.ix_(index, index)] += j.T @ w @ j
        rhs[index] -= j.T @ w @ error(np.zeros(dof), np.zeros(dof))
    return h[dof:, dof:], rhs[dof:]


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize(("nodes", "extra"), [(2, 0), (40, 0), (60, 60), (50, 600)])
def test_solutions_are_those_of_the_dense_system(dimension, nodes, extra):
    graph = random_graph(dimension, nodes, extra, seed=nodes + extra, noise=0.05)
    h, rhs = dense(graph, graph.poses)
    equations = equations_of(graph)
    equations.linearize(graph.poses)
    damping = np.linspace(0.5, 2, len(rhs))
    assert equations.factorize(damping) == -1
    expected = np.linalg.solve(h + np.diag(damping), rhs)
    assert np.allclose(equations.solve(), expected, rtol=1e-5, atol=1e-6 * np.abs(expected).max())


@pytest.mark.parametrize("dimension", [2, 3])
def test_any_number_of_threads_gives_the_same_bits(dimension):
    graph = random_graph(dimension, 3000, 3000, seed=1, noise=0.05)
    solutions = []
    for threads in (1, 2, 3):
        equations = equations_of(graph, threads)
        equations.linearize(graph.poses)
        for _ in range(2):
            assert equations.factorize(np.zeros(2999 * lie.DOF[dimension])) == -1
        solutions.append(equations.solve())
    assert (solutions[0] == solutions[1]).all()
    assert (solutions[0] == solutions[2]).all()


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("failing", [1, 37, 199])
def test_the_node_at_which_a_pivot_fails_is_named(failing, threads):
    graph = random_graph(2, 200, 200, seed=2, noise=0.05)
    equations = equations_of(graph, threads)
    equations.linearize(graph.poses)
    damping = np.zeros(199 * 3)
    damping[3 * (failing - 1) + 1] = -1e9
    assert equations.factorize(damping) == failing
    damping[:] = np.nan
    assert equations.factorize(damping) > 0
    assert equations.factorize(np.zeros(199 * 3)) == -1


def test_a_large_spatial_system_is_solved_to_rounding():
    graph = perturb(sphere(900), (0.02, 0.01), seed=1)
    equations = equations_of(graph)
    equations.linearize(graph.poses)
    none = np.zeros(899 * 6)
    assert equations.factorize(none) == -1
    step = equations.solve()
    # The same system moved by a tiny damping has a solution as close.
    assert equations.factorize(none + 1e-9) == -1
    assert np.allclose(equations.solve(), step, rtol=1e-6, atol=1e-9)


def test_fill_counts_the_entries_of_the_factor():
    # A chain of 4 nodes, one fixed: three 3x3 blocks on the diagonal, two beside it.
    poses = random_poses(2, 4, np.random.default_rng(0))
    chain = PoseGraph.from_arrays([(0, 1), (1, 2), (2, 3)], [(1, 0, 0)] * 3, poses=poses)
    assert chain.elimination.fill(3) == 3 * 6 + 2 * 9


def matrix_of(edges, weights, nodes):
    """The weighted graph Laplacian of edges, node 0 fixed."""
    topology = Topology(nodes, np.array(edges, np.int32))
    fixed = np.zeros(nodes, bool)
    fixed[0] = True
    matrix = GraphMatrix(Elimination(topology, fixed, NO_ORDER), 1)
    w = np.array(weights, float)[:, None, None]
    matrix.assemble(topology, w, -w, w, np.zeros((nodes, 1, 1)))
    return matrix


def test_the_pivot_ratio_of_small_matrices():
    # Without off-diagonal entries each pivot is its diagonal entry.
    apart = matrix_of([(0, 1), (0, 2)], [2, 1e-9], 3)
    assert apart.factorize(np.zeros(2)) == -1
    assert np.isclose(apart.pivot_ratio(), 1, rtol=1e-15)
    # [[3, -1], [-1, 1]]: the second pivot is 1 - 1 / 3 or 3 - 1, of 1 or 3.
    chain = matrix_of([(0, 1), (1, 2)], [2, 1], 3)
    assert chain.factorize(np.zeros(2)) == -1
    assert np.isclose(chain.pivot_ratio(), 2 / 3, rtol=1e-15)
    # Damping is part of the diagonal: [[4, -1], [-1, 2]] leaves 2 - 1 / 4 of 2.
    assert chain.factorize(np.ones(2)) == -1
    assert np.isclose(chain.pivot_ratio(), 7 / 8, rtol=1e-15)


@pytest.mark.parametrize("weak", [1e-3, 1e-8, 1e-12])
def test_the_pivot_ratio_shows_a_nearly_free_part(weak):
    # Two triangles that one edge joins. The last pivot of the second one is that edge's.
    triangles = [(0, 1), (1, 2), (2, 0), (3, 4), (4, 5), (5, 3), (2, 3)]
    matrix = matrix_of(triangles, [1] * 6 + [weak], 6)
    assert matrix.factorize(np.zeros(5)) == -1
    assert weak / 4 < matrix.pivot_ratio() < weak
    poses = np.zeros((6, 3))
    information = np.tile(np.eye(3), (7, 1, 1))
    information[-1] *= weak
    graph = PoseGraph.from_arrays(triangles, np.zeros((7, 3)), information, poses=poses)
    for threads in (1, 2):
        equations = equations_of(graph, threads)
        equations.linearize(poses)
        assert equations.factorize(np.zeros(15)) == -1
        assert weak / 4 < equations.pivot_ratio() < weak


@pytest.mark.skipif(not TASKS.is_dir(), reason="counts threads in /proc")
def test_no_more_threads_start_than_find_work():
    def started(graph, threads):
        before = len(list(TASKS.iterdir()))
        equations = equations_of(graph, threads)
        equations.linearize(graph.poses)
        assert equations.factorize(np.zeros_like(equations.rhs())) == -1
        return len(list(TASKS.iterdir())) - before, equations.solve()

    small, large = random_graph(2, 3, 0, seed=0), random_graph(2, 3000, 3000, seed=1, noise=0.05)
    assert started(small, 100_000)[0] == 0
    count, solution = started(large, 100_000)
    assert 1 <= count < max(os.cpu_count(), 64)
    assert (solution == started(large, 1)[1]).all()


@pytest.fixture(scope="module")
def cube():
    """A grid of poses, whose factor has much fill-in."""
    side = 15
    index = np.arange(side**3, dtype=np.int32).reshape(side, side, side)
    edges = [
        np.stack([index.take(range(side - 1), axis), index.take(range(1, side), axis)], -1)
        for axis in range(3)
    ]
    edges = np.concatenate([e.reshape(-1, 2) for e in edges])
    identity = np.array([0, 0, 0, 0, 0, 0, 1.0])
    z, poses = np.tile(identity, (len(edges), 1)), np.tile(identity, (side**3, 1))
    return PoseGraph.from_arrays(edges, z, poses=poses)


@contextmanager
def handler_of(code, handler):
    before = signal.signal(code, handler)
    try:
        yield
    finally:
        signal.signal(code, before)


def interrupt(*_):
    signal.setitimer(signal.ITIMER_REAL, 0)
    raise KeyboardInterrupt


def factorize_forever(equations, damping):
    while True:
        assert equations.factorize(damping) == -1


@needs_timers
@pytest.mark.parametrize("threads", [1, 2])
def test_an_interrupted_factorization_counts_as_failed(cube, threads):
    equations = equations_of(cube, threads)
    equations.linearize(cube.poses)
    damping = np.ones_like(equations.rhs())
    with handler_of(signal.SIGALRM, interrupt):
        # An interrupt between two factorizations, which is rare, proves nothing.
        for _ in range(20):
            signal.setitimer(signal.ITIMER_REAL, 0.03)
            with pytest.raises(KeyboardInterrupt):
                factorize_forever(equations, damping)
            try:
                equations.solve()
            except RuntimeError:
                break
        else:
            pytest.fail("no factorization was interrupted")
    assert equations.factorize(damping) == -1
    assert np.allclose(equations.solve(), 0)


@needs_timers
@pytest.mark.parametrize("call", ["factorize", "solve", "inverse in the pattern", "inverse"])
def test_signals_are_handled_during_long_calls(cube, call):
    nodes = len(cube.ids) - 1
    fixed = np.arange(nodes + 1) == 0
    elimination = Elimination(cube.topology, fixed, NO_ORDER)
    matrix = GraphMatrix(elimination, 6)
    weight = np.tile(np.eye(6), (len(cube.edge_indices), 1, 1))
    matrix.assemble(cube.topology, weight, -weight, weight, np.zeros((nodes + 1, 6, 1)))
    assert matrix.factorize(np.zeros(6 * nodes)) == -1
    index = np.arange(nodes, dtype=np.int32)
    calls = {
        "factorize": lambda: matrix.factorize(np.zeros(6 * nodes)),
        "solve": lambda: matrix.solve(np.ones((nodes, 6, 128))),
        "inverse in the pattern": lambda: matrix.inverse(index, index),
        "inverse": lambda: matrix.inverse(index[:60], index[-60:]),
    }
    handled = []
    with handler_of(signal.SIGALRM, lambda *_: handled.append(call)):
        signal.setitimer(signal.ITIMER_REAL, 0.005, 0.005)
        calls[call]()
        signal.setitimer(signal.ITIMER_REAL, 0)
    # Without a look at the signals they would all be handled as one, after the call.
    assert len(handled) >= 2
