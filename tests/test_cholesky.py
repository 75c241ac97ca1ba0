import numpy as np
import pytest
from random_graphs import random_graph, random_poses

from masat import PoseGraph, lie
from masat._core import Elimination, NormalEquations
from masat.worlds import perturb, sphere


def equations_of(graph, threads=1):
    held = np.zeros(len(graph.ids), bool)
    held[0] = True
    order = Elimination(graph.topology, held, np.empty(0, np.int32))
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
        place = np.concatenate([a * dof + np.arange(dof), b * dof + np.arange(dof)])
        h[np.ix_(place, place)] += j.T @ w @ j
        rhs[place] -= j.T @ w @ error(np.zeros(dof), np.zeros(dof))
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
@pytest.mark.parametrize("broken", [1, 37, 199])
def test_the_node_at_which_a_pivot_breaks_is_named(broken, threads):
    graph = random_graph(2, 200, 200, seed=2, noise=0.05)
    equations = equations_of(graph, threads)
    equations.linearize(graph.poses)
    damping = np.zeros(199 * 3)
    damping[3 * (broken - 1) + 1] = -1e9
    assert equations.factorize(damping) == broken
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
    # A chain of 4 nodes, one held: three 3x3 blocks on the diagonal, two beside it.
    poses = random_poses(2, 4, np.random.default_rng(0))
    chain = PoseGraph.from_arrays([(0, 1), (1, 2), (2, 3)], [(1, 0, 0)] * 3, poses=poses)
    assert chain.elimination.fill(3) == 3 * 6 + 2 * 9
