"""The better parts of several minima, taken together."""

import numpy as np
import pytest
from random_graphs import random_graph
from test_search import CHAIN, search_of, two_rings

import masat
from masat import lie
from masat.optimality import best
from masat.optimality.splices import OtherMinimum, spliced
from masat.optimality.subgraphs import subgraph
from masat.worlds import WORLDS, perturb


def test_two_minima_differ_where_only_one_of_them_is_twisted():
    graph = two_rings(second_twisted=False)
    other = two_rings(first_twisted=False)
    minimum = OtherMinimum(other.poses)
    parts = list(minimum.parts(graph, graph.poses))
    first = [part for part in parts if part[:12].any()]
    second = [part for part in parts if part[12 + CHAIN :].any()]
    assert len(first) == len(second) == 1
    # Two edges around are free, the middle of the chain is not.
    assert not (first[0] | second[0])[12 + 4 : 12 + CHAIN - 4].any()
    assert list(OtherMinimum(graph.poses).parts(graph, graph.poses)) == []
    # What was refused is not tried again until it is elsewhere.
    minimum.refuse(first[0], graph, graph.poses)
    assert not any(np.array_equal(p, first[0]) for p in minimum.parts(graph, graph.poses))
    turned = lie.compose(np.array([0, 0, 0.1]), graph.poses)
    assert any(np.array_equal(p, first[0]) for p in minimum.parts(graph, turned))


def test_minima_that_are_each_wrong_in_another_part_make_a_right_one():
    graph = two_rings(second_twisted=False)
    other = two_rings(first_twisted=False)
    search = search_of(graph)
    assert search.chi2 > 1
    search.combine([other.poses])
    assert search.chi2 < 1e-9
    assert np.allclose(np.sin(search.poses[:, 2]), 0, atol=1e-6)


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_minimum_elsewhere_is_moved_back_as_a_whole(dimension):
    graph = random_graph(dimension, 30, 40, seed=1, noise=0.01)
    move = random_graph(dimension, 2, 0, seed=5).poses[1]
    inside = np.arange(30) < 12
    part = subgraph(graph, graph.poses, inside)
    other = lie.compose(move, graph.poses)
    assert np.abs(lie.local(spliced(part, other), part.graph.poses)).max() < 1e-9
    # Without a border there is nothing to move it to.
    everything = subgraph(graph, graph.poses, np.ones(30, np.bool_))
    assert np.allclose(spliced(everything, other), other)


@pytest.mark.slow
def test_a_noisy_torus_ends_no_higher_than_from_the_truth():
    graph = perturb(WORLDS["torus"](500, seed=100), (0.5, 0.5), seed=100)
    assert masat.solve(graph).chi2 <= masat.optimize(graph).chi2 * (1 + 1e-6)


def test_a_small_graph_is_searched_although_its_first_map_cannot_be_right():
    graph = random_graph(3, 40, 50, seed=2, noise=0.4)
    assert masat.optimize(masat.initialize(graph, "chordal")).chi2 > 390
    assert masat.solve(graph).chi2 < 165


def test_where_a_search_is_too_expensive_other_guesses_are_tried(monkeypatch):
    monkeypatch.setattr(best, "_search_operations", lambda _: np.inf)
    graph = random_graph(3, 40, 50, seed=2, noise=0.4)
    stages = []
    result = masat.solve(graph, report_stage=stages.append)
    assert not any("searching" in stage.what for stage in stages)
    assert result.chi2 < 200
    # They are not where that is expensive, too.
    monkeypatch.setattr(best, "_AFFORDABLE", 0.0)
    assert masat.solve(graph).chi2 > 390
