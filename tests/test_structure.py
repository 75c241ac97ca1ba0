import sys
from itertools import pairwise

import numpy as np
import pytest

import masat
from masat import PoseGraph
from masat._core import Elimination, NormalEquations
from masat.structure import eliminate, nested_dissection
from masat.worlds import sphere

NO_ORDER = np.empty(0, np.int32)


def chain(nodes):
    edges = [(k, k + 1) for k in range(nodes - 1)]
    return PoseGraph.from_arrays(edges, [(1, 0, 0)] * (nodes - 1))


def held(graph):
    out = np.zeros(len(graph.ids), bool)
    out[0] = True
    return out


def test_entries_and_operations_are_those_of_the_factor():
    # Three free nodes in a row: columns of 2, 2 and 1 blocks, of 2 x 2 numbers each.
    order = chain(4).elimination
    assert order.free_nodes().tolist() == [1, 2, 3]
    assert order.fill(2) == (4 + 3) + (4 + 3) + (2 + 1)
    assert order.operations(2) == 2 * (4**2 + 3**2) + 2**2 + 1**2


def test_a_bad_order_is_counted_as_such():
    # A star: to begin with the hub joins all the others.
    star = PoseGraph.from_arrays([(0, k) for k in range(1, 6)], [(1, 0, 0)] * 5)
    nothing = np.zeros(6, bool)
    hub_first = Elimination(star.topology, nothing, np.arange(6, dtype=np.int32))
    hub_last = Elimination(star.topology, nothing, np.arange(6, dtype=np.int32)[::-1].copy())
    assert hub_first.fill(1) == 6 * 7 // 2
    assert hub_last.fill(1) == 6 + 5
    assert Elimination(star.topology, nothing, NO_ORDER).fill(1) == 6 + 5


def test_the_adjacency_holds_both_directions():
    start, neighbors = chain(4).elimination.adjacency()
    assert start.tolist() == [0, 1, 3, 4]
    assert [sorted(neighbors[a:b]) for a, b in pairwise(start)] == [
        [1], [0, 2], [1],
    ]  # fmt: skip


@pytest.fixture(scope="module")
def ball():
    return sphere(8000, seed=0)


def test_much_work_is_dissected(ball):
    pytest.importorskip("pymetis")
    by_degree = Elimination(ball.topology, held(ball), NO_ORDER)
    dissected = Elimination(ball.topology, held(ball), nested_dissection(by_degree))
    assert dissected.operations(6) < 0.8 * by_degree.operations(6)
    assert ball.elimination.operations(6) == dissected.operations(6)
    solved = []
    for order in (by_degree, dissected):
        system = NormalEquations(ball.topology, order, ball.measurements, ball.information)
        system.linearize(masat.lie.retract(ball.poses, np.full((8000, 6), 1e-3)))
        assert system.factorize(np.zeros_like(system.rhs())) == -1
        solved.append(system.solve())
    assert np.allclose(*solved, rtol=1e-8, atol=1e-11)


def test_little_work_is_not_dissected(monkeypatch):
    monkeypatch.setattr("masat.structure.nested_dissection", lambda _: pytest.fail("dissected"))
    assert eliminate(chain(100).topology, held(chain(100)), 3).fill(3) > 0


def test_without_the_library_minimum_degree_stands(ball, monkeypatch):
    monkeypatch.setitem(sys.modules, "pymetis", None)
    order = eliminate(ball.topology, held(ball), 6)
    by_degree = Elimination(ball.topology, held(ball), NO_ORDER)
    assert order.operations(6) == by_degree.operations(6)
