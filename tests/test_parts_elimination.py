from concurrent.futures import ThreadPoolExecutor
from itertools import combinations

import numpy as np
import pytest
from random_graphs import random_graph

import masat
from masat._core import Elimination, NormalEquations, Topology, free_workspace
from masat.parts.covers import smallest_cover
from masat.parts.dissection import dissect, dissect_evenly, given_labels
from masat.worlds import city, perturb, sphere

CITY = masat.initialize(perturb(city(1000), (0.05, 0.05, 0.02)), "masat")
SPHERE = masat.initialize(perturb(sphere(400), (0.05, 0.02)), "masat")
GRAPHS = {"city": CITY, "sphere": SPHERE}


def packed(matrix):
    return np.concatenate([matrix[k:, k] for k in range(len(matrix))])


def scalars(nodes, d):
    return (np.asarray(nodes)[:, None] * d + np.arange(d)).ravel()


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize("seed", range(4))
def test_an_elimination_leaves_the_schur_complement_at_the_boundary(dimension, threads, seed):
    # The last node stands for a contribution block of some others, which comes from elsewhere.
    random = np.random.default_rng(seed)
    graph = random_graph(dimension, 60, 50, seed, noise=0.1)
    n, d = len(graph), graph.dof
    clique = random.permutation(n)[:9].astype(np.int32)
    boundary = random.permutation(n)[:7]
    inner = np.setdiff1d(np.arange(n), boundary)
    joined = np.stack([np.full(9, n), clique], 1)
    edges = np.concatenate([graph.edge_indices, joined]).astype(np.int32)
    order = np.concatenate([[n], random.permutation(inner), boundary]).astype(np.int32)
    elimination = Elimination(Topology(n + 1, edges), np.zeros(n + 1, bool), order, 7, 1)
    topology = Topology(n + 1, graph.edge_indices)
    equations = NormalEquations(
        topology, elimination, graph.measurements, graph.information, threads
    )
    equations.linearize(np.concatenate([graph.poses, graph.poses[:1]]))
    h = np.column_stack([equations.multiply(e) for e in np.eye((n + 1) * d)])
    root = random.normal(size=(9 * d, 9 * d))
    damping = random.uniform(0.1, 1, (n + 1) * d)
    assert equations.factorize(damping, [(clique, packed(root @ root.T))]) == -1
    h += np.diag(damping)
    h[np.ix_(scalars(clique, d), scalars(clique, d))] += root @ root.T
    i, b, rhs = scalars(inner, d), scalars(boundary, d), equations.rhs()
    gain = np.linalg.solve(h[np.ix_(i, i)], h[np.ix_(i, b)]).T
    schur = h[np.ix_(b, b)] - gain @ h[np.ix_(i, b)]
    np.testing.assert_allclose(
        equations.contribution(), packed(schur), rtol=0, atol=1e-12 * abs(schur).max()
    )
    reduced = equations.reduce(rhs)
    expected = rhs[b] - gain @ rhs[i]
    np.testing.assert_allclose(reduced[b], expected, rtol=0, atol=1e-12 * abs(rhs).max())
    reduced[b] = np.linalg.solve(schur, expected)
    every = np.concatenate([i, b])
    step = equations.substitute(reduced)[every]
    whole = np.linalg.solve(h[np.ix_(every, every)], rhs[every])
    np.testing.assert_allclose(step, whole, rtol=0, atol=1e-11 * abs(whole).max())


def test_a_part_alone_has_no_solution():
    graph = random_graph(2, 5, 2, 0, noise=0.1)
    order = np.arange(5, dtype=np.int32)
    elimination = Elimination(graph.topology, np.zeros(5, bool), order, 2)
    equations = NormalEquations(graph.topology, elimination, graph.measurements, graph.information)
    equations.linearize(graph.poses)
    assert equations.factorize(np.ones(15)) == -1
    with pytest.raises(RuntimeError, match="has a boundary"):
        equations.solve()


def test_values_at_a_boundary_are_asked_for_before_another_part_is_factorized():
    def part(seed):
        graph = random_graph(2, 6, 3, seed, noise=0.1)
        order = np.arange(6, dtype=np.int32)
        elimination = Elimination(graph.topology, np.zeros(6, bool), order, 2)
        equations = NormalEquations(
            graph.topology, elimination, graph.measurements, graph.information
        )
        equations.linearize(graph.poses)
        assert equations.factorize(np.ones(18)) == -1
        return equations

    one = part(0)
    known = one.contribution()
    other = part(1)
    with pytest.raises(RuntimeError, match="another part has been factorized"):
        one.contribution()
    assert one.factorize(np.ones(18)) == -1
    assert np.array_equal(one.contribution(), known)
    with ThreadPoolExecutor(1) as thread:
        # The workspace of another thread holds what that thread has factorized.
        assert thread.submit(one.factorize, np.ones(18)).result() == -1
        assert thread.submit(other.factorize, np.ones(18)).result() == -1
        with pytest.raises(RuntimeError, match="another part has been factorized"):
            one.contribution()
    free_workspace()
    with pytest.raises(RuntimeError, match="another part has been factorized"):
        one.contribution()


@pytest.mark.parametrize("seed", range(40))
def test_a_smallest_cover_is_one_that_no_smaller_set_is(seed):
    random = np.random.default_rng(seed)
    edges = np.stack([random.integers(0, 6, 12), random.integers(10, 16, 12)], 1)
    found = smallest_cover(edges[:, 0], edges[:, 1])
    assert np.isin(edges, found).any(axis=1).all()
    for smaller in combinations(np.unique(edges), len(found) - 1):
        assert not np.isin(edges, smaller).any(axis=1).all()


@pytest.mark.parametrize("given", [False, True])
@pytest.mark.parametrize("parts", [1, 2, 3, 8])
@pytest.mark.parametrize("name", GRAPHS)
def test_separators_part_what_is_below_them(name, parts, given):
    graph = GRAPHS[name]
    if given:
        tree = dissect(graph, given_labels(graph, graph.ids * parts // len(graph)))
    else:
        tree = dissect_evenly(graph, parts)

    def above(piece):
        found = {piece}
        while tree.parent[piece] >= 0:
            assert tree.parent[piece] > piece
            piece = tree.parent[piece]
            found.add(piece)
        return found

    lines = [above(piece) for piece in range(len(tree.parent))]
    assert (tree.piece >= 0).sum() == len(graph.structure.free)
    for a, b in tree.piece[graph.edge_indices].tolist():
        assert a < 0 or b < 0 or a in lines[b] or b in lines[a]
    if given:
        return
    # The parts are of about the same size, the separators are small.
    sizes = np.bincount(tree.piece[tree.piece >= 0])[:parts]
    assert sizes.max() < 1.5 * len(graph) / parts
    assert (tree.piece >= parts).sum() < 0.35 * len(graph)
