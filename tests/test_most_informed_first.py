from itertools import pairwise

import numpy as np
import pytest
from random_graphs import random_graph

import masat
from masat import PoseGraph
from masat.worlds import manhattan, perturb, sphere


def most_informed_first(graph, **options):
    return masat.initialize(graph, "most_informed_first", **options).poses


def along_x(edges, steps, **options):
    return PoseGraph.from_arrays(edges, [(x, 0, 0) for x in steps], **options)


def chi2(graph, method):
    return masat.optimize(masat.initialize(graph, method), max_iterations=0).initial_chi2


def test_a_node_with_two_opinions_goes_before_one_with_one():
    # MASAT places 1, 2, 3; here 3, of which 1 speaks as well, comes before 2 and speaks of it.
    graph = along_x([(0, 1), (0, 2), (0, 3), (1, 3), (3, 2)], [1, 5, 2, 1.6, 1])
    assert np.allclose(most_informed_first(graph)[:, 0], [0, 1, (5 + 3.3) / 2, (2 + 2.6) / 2])
    assert np.allclose(masat.initialize(graph, "masat").poses[:, 0], [0, 1, 5, 8.6 / 3])


@pytest.mark.parametrize(("chain", "x"), [(1, (-3, 0)), (2, (0, 3))])
def test_the_order_is_that_of_information(chain, x):
    # `one` hears a node at variance 1/2, from two measurements: information 2/3. `two` hears the
    # ends of two chains. Ends at variance 1, of information 1, come first, and make it 2 / (1 + 1)
    # for `two`. Ends at variance 2, of information 1/2, come after `one`; what that and the first
    # end say of `two`, 2/5 + 1/3, makes it come before the second. Who comes later hears the edge
    # between the two.
    left, right = [0, *range(1, chain + 1)], [0, *range(chain + 1, 2 * chain + 1)]
    middle, one, two = range(2 * chain + 1, 2 * chain + 4)
    edges = [*pairwise(left), *pairwise(right), (0, middle), (0, middle)]
    edges += [(middle, one), (left[-1], two), (right[-1], two)]
    graph = along_x([*edges, (one, two)], [0] * len(edges) + [6])
    assert np.allclose(most_informed_first(graph)[[one, two], 0], x)


@pytest.mark.parametrize("dimension", [2, 3])
def test_on_a_tree_it_is_masat(dimension):
    graph = random_graph(dimension, 60, 0, seed=2)
    assert np.allclose(most_informed_first(graph), masat.initialize(graph, "masat").poses)


def test_fixed_nodes_are_certain():
    # Both ends say alike of 1 and 2; 1 goes first, and then speaks of 2 beside its fixed neighbor.
    graph = along_x(
        [(0, 1), (1, 2), (2, 3)], [1, 1, 1], poses=[(x, 0, 0) for x in (0, 9, 9, 3.4)], fixed=[0, 3]
    )
    assert np.allclose(most_informed_first(graph)[:, 0], [0, 1, (2 + 2.4) / 2, 3.4])


def test_neither_long_chains_nor_many_opinions_leave_the_scale():
    n = 200_000
    steps = np.arange(n)
    chain = along_x(np.column_stack([steps, steps + 1]), np.ones(n))
    assert np.allclose(most_informed_first(chain)[:, 0], np.arange(n + 1))
    bundle = along_x([(0, 1)] * n + [(1, 2)], np.append(steps, 1))
    assert np.allclose(most_informed_first(bundle)[:, 0], [0, (n - 1) / 2, (n + 1) / 2])


@pytest.mark.parametrize(("world", "sigma"), [(manhattan, (0.1, 0.1, 0.1)), (sphere, (0.05, 0.05))])
def test_it_fits_noisy_worlds_better_than_masat(world, sigma):
    ratios = []
    for seed in range(5):
        graph = perturb(world(1000, 1900, seed=seed), sigma, seed=seed)
        ratios.append(chi2(graph, "most_informed_first") / chi2(graph, "masat"))
    assert np.median(ratios) < 0.8
