"""The order in which bodies are placed, and what it is found by."""

import numpy as np
import pytest

import masat
from masat import MasatWarning, PoseGraph
from masat.groups import Groups
from masat.initializers.waiting import WaitingBodies


def test_members_of_groups_are_those_of_a_search():
    labels = np.random.default_rng(0).integers(7, size=50)
    labels[labels == 3] = 4
    groups = Groups(labels, 9)
    for label in range(9):
        assert groups.of(label).tolist() == np.flatnonzero(labels == label).tolist()
    wanted = np.array([8, 2, 3, 0])
    expected = [k for label in wanted for k in np.flatnonzero(labels == label)]
    assert groups.of_all(wanted).tolist() == expected
    assert groups.of_all(wanted[:0]).tolist() == []


def test_bodies_with_enough_positions_come_together_and_the_others_by_strength():
    waiting = WaitingBodies(6, 2)
    bodies, rows = np.array([5, 1, 2, 1, 3, 5, 4]), np.arange(10, 17)
    positions = np.array([1.0, 1, 1, 1, 0, 2, 0])
    rotations = np.array([0.0, 0, 1, 0, 9, 0, 2])
    waiting.add(bodies, rows, positions, rotations)
    assert waiting.rows[5] == [10, 15]
    assert waiting.take() == [1, 5]
    # Two measured things before one, then the larger weight.
    waiting.add(np.array([4]), np.array([17]), np.array([0.0]), np.array([9.0]))
    assert [waiting.take() for _ in range(4)] == [[4], [2], [3], []]


@pytest.mark.parametrize("partial", [np.diag([1.0, 1, 0]), np.diag([1.0, 0, 0])])
def test_a_chain_of_partial_edges_is_placed_node_by_node(partial):
    # Positions alone, or too little for a match: then the translations are solved from the origin.
    graph = PoseGraph.from_arrays([(k, k + 1) for k in range(50)], [(1, 0, 0)] * 50, partial)
    with pytest.warns(MasatWarning, match="not determined"):
        guess = masat.initialize(graph, "spanning_tree")
    assert np.allclose(guess.poses[:, 0], np.arange(51))
    assert np.allclose(guess.poses[:, 1:], 0)
