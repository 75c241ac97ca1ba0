import pickle
import sys
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

import masat
from masat import GraphError, PoseGraph
from masat._core import Elimination, NormalEquations
from masat.assembly import assemble
from masat.structure import Structure, eliminate, nested_dissection
from masat.worlds import WORLDS, sphere

NO_ORDER = np.empty(0, np.int32)


def chain(nodes):
    edges = [(k, k + 1) for k in range(nodes - 1)]
    return PoseGraph.from_arrays(edges, [(1, 0, 0)] * (nodes - 1))


def first_in_gauge(graph):
    out = np.zeros(len(graph.ids), bool)
    out[0] = True
    return out


def test_entries_and_operations_are_those_of_the_factor():
    # Three free nodes in a row: columns of 2, 2 and 1 blocks, of 2 x 2 numbers each.
    order = chain(4).elimination
    assert order.free_nodes().tolist() == [1, 2, 3]
    assert order.fill(2) == (4 + 3) + (4 + 3) + (2 + 1)
    assert order.operations(2) == 2 * (4**2 + 3**2) + 2**2 + 1**2


def test_a_bad_order_costs_more_operations():
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
    by_degree = Elimination(ball.topology, first_in_gauge(ball), NO_ORDER)
    dissected = Elimination(ball.topology, first_in_gauge(ball), nested_dissection(by_degree))
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
    assert eliminate(chain(100).topology, first_in_gauge(chain(100)), 3).fill(3) > 0


def test_without_the_library_minimum_degree_is_used(ball, monkeypatch):
    monkeypatch.setitem(sys.modules, "pymetis", None)
    order = eliminate(ball.topology, first_in_gauge(ball), 6)
    by_degree = Elimination(ball.topology, first_in_gauge(ball), NO_ORDER)
    assert order.operations(6) == by_degree.operations(6)


PARTS = [[5, 9], [9, 2], [7, 4], [3, 8]]
"""Components 2, 5, 9 and 3, 8 and 4, 7."""


def parts(**more):
    return PoseGraph.from_arrays(PARTS, [[1, 0, 0]] * len(PARTS), **more)


def test_graphs_that_differ_only_in_poses_share_one_structure():
    graph = parts()
    moved = graph.with_poses(np.zeros((7, 3)), notes=["moved"])
    without = replace(moved, poses=None)
    assert moved.structure is without.structure is graph.structure
    # Shared whichever graph asks first.
    assert moved.elimination is graph.elimination
    assert graph.topology is moved.topology
    assert graph.components is without.components


def test_a_replaced_array_that_the_structure_depends_on_gets_a_new_structure():
    graph = parts()
    assert graph.gauge.tolist() == [2, 3, 4]
    reversed_edges = replace(graph, edges=graph.edges[:, ::-1].copy())
    assert reversed_edges.edge_indices.tolist() == graph.edge_indices[:, ::-1].tolist()
    fixed = replace(graph, fixed=np.array([9]))
    assert fixed.gauge.tolist() == [3, 4, 9]
    assert graph.gauge.tolist() == [2, 3, 4]


def test_the_free_nodes_are_those_outside_the_gauge():
    structure = parts(fixed=[9]).structure
    assert structure.gauge.tolist() == [3, 4, 9]
    assert structure.free.tolist() == [0, 3, 4, 5]
    assert structure.elimination.free_nodes().tolist() == [0, 3, 4, 5]


def test_a_root_is_the_gauge_fixed_node_of_its_component():
    graph = parts()
    rooted = graph.with_root(9)
    assert rooted.gauge.tolist() == [3, 4, 9]
    assert graph.gauge.tolist() == [2, 3, 4]
    assert rooted.elimination.free_nodes().tolist() == [0, 3, 4, 5]
    assert graph.elimination.free_nodes().tolist() == [3, 4, 5, 6]
    # The connectivity is that of the graph before.
    assert rooted.topology is graph.topology
    assert rooted.components is graph.components
    assert rooted.with_poses(np.zeros((7, 3))).gauge.tolist() == [3, 4, 9]


def test_a_second_root_replaces_only_that_of_its_component():
    graph = parts().with_root(9).with_root(7).with_root(5)
    assert graph.gauge.tolist() == [3, 5, 7]
    assert parts().with_root([7, 5]).gauge.tolist() == [3, 5, 7]


def test_a_fixed_root_changes_nothing():
    graph = parts(fixed=[9])
    assert graph.with_root(9).gauge.tolist() == graph.gauge.tolist() == [3, 4, 9]


@pytest.mark.parametrize(
    ("root", "message"),
    [
        (5, "the root 5 is not fixed but its component holds fixed nodes, which keep their poses"),
        (6, "the graph has no node 6"),
        ([3, 8], "the roots 3 and 8 are in one component"),
        ("a", "roots must be integers"),
    ],
)
def test_a_root_that_cannot_be_one_is_refused(root, message):
    with pytest.raises(GraphError, match=message):
        parts(fixed=[9]).with_root(root)


@given(st.sets(st.integers(0, 9)), st.sets(st.integers(0, 9)), st.data())
def test_each_component_has_its_fixed_nodes_or_one_other_in_the_gauge(cuts, fixed, data):
    edges = [(k, k + 1) for k in range(9) if k not in cuts]
    graph = PoseGraph.from_arrays(
        edges, [[1, 0, 0]] * len(edges), ids=range(10), poses=np.zeros((10, 3)), fixed=fixed
    )
    roots = []
    for label in range(graph.components.max() + 1):
        members = np.flatnonzero(graph.components == label)
        allowed = sorted(fixed & set(members.tolist())) or members.tolist()
        root = data.draw(st.none() | st.sampled_from(allowed))
        if root is not None:
            graph = graph.with_root(root)
        chosen = root if root is not None else members[0]
        expected = sorted(fixed & set(members.tolist())) or [chosen]
        roots += expected
    assert graph.gauge.tolist() == sorted(roots)
    free = [k for k in range(10) if k not in roots]
    assert graph.structure.free.tolist() == free
    assert graph.elimination.free_nodes().tolist() == free


def test_a_structure_needs_no_graph():
    graph = parts(fixed=[9])
    structure = Structure(graph.ids, graph.edges, graph.fixed, graph.dof)
    assert structure.edge_indices.tolist() == graph.edge_indices.tolist()
    assert structure.gauge.tolist() == graph.gauge.tolist()
    assert structure.index([9, 2]).tolist() == [6, 0]


def test_fixes_change_the_order_of_a_graph_by_its_root_alone():
    world = WORLDS["manhattan"](300, 500, seed=2)
    fixed = world.with_priors(masat.gps(world.ids[5::20], world.poses[5::20, :2], 0.5))
    graph = assemble(fixed).graph
    alone, both = world.elimination, graph.elimination
    order = alone.free_nodes()[alone.order()]
    assert_array_equal(both.free_nodes()[both.order()], [*order, 0])
    other = pickle.loads(pickle.dumps(graph.structure))
    assert_array_equal(other.elimination.order(), both.order())
