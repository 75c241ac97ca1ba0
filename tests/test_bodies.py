"""Rigid bodies of a graph, and steps after which the translations are solved for anew."""

import numpy as np
import pytest
from random_graphs import random_graph

import masat
from masat import lie
from masat.assembly import assemble
from masat.optimality.bodies import rigid_bodies
from masat.optimizers.equations import normal_equations
from masat.optimizers.projection import ProjectedEquations
from masat.optimizers.translations import solve_translations
from masat.residuals import chi2_per_edge
from masat.worlds import WORLDS


def stiff_edges(graph, seed=0):
    return np.random.default_rng(seed).random(len(graph.edges)) < 0.3


@pytest.mark.parametrize("dimension", [2, 3])
def test_bodies_cost_what_the_edges_between_them_cost(dimension):
    graph = random_graph(dimension, 30, 40, seed=3, noise=0.1)
    stiff = stiff_edges(graph)
    bodies = rigid_bodies(graph, stiff)
    i, j = graph.edge_indices.T
    assert (bodies.body[i[stiff]] == bodies.body[j[stiff]]).all()
    assert 1 < len(bodies.graph.ids) < 30
    between = bodies.body[i] != bodies.body[j]
    own = chi2_per_edge(graph, graph.poses)
    assert bodies.graph.chi2 == pytest.approx(own[between].sum())
    # And so they do wherever they move, while the edges within them cost what they did.
    random = np.random.default_rng(5)
    steps = 0.4 * random.normal(size=(len(bodies.graph.ids), lie.DOF[dimension]))
    moved = lie.retract(bodies.graph.poses, steps)
    there = chi2_per_edge(graph, bodies.expanded(moved))
    assert bodies.graph.with_poses(moved).chi2 == pytest.approx(there[between].sum())
    assert there[~between] == pytest.approx(own[~between], abs=1e-9)


def test_bodies_keep_what_sensors_measure():
    graph = WORLDS["manhattan"](40, 60, seed=2)
    fixes = masat.gps([3, 30], [[1.0, 2.0], [4.0, 3.0]], 0.5, lever_arm=[0.2, 0.1])
    whole = assemble(graph.with_priors(fixes)).graph
    bodies = rigid_bodies(whole, stiff_edges(whole))
    i, j = whole.edge_indices.T
    between = bodies.body[i] != bodies.body[j]
    assert bodies.graph.chi2 == pytest.approx(chi2_per_edge(whole, whole.poses)[between].sum())


@pytest.mark.parametrize("dimension", [2, 3])
def test_bodies_rotate_as_their_nodes_do_on_average(dimension):
    graph = random_graph(dimension, 30, 40, seed=3, noise=0.1)
    bodies = rigid_bodies(graph, stiff_edges(graph))
    steps = np.zeros((len(bodies.graph.ids), lie.DOF[dimension]))
    steps[:, dimension:] = 0.4 * np.random.default_rng(1).normal(size=steps[:, dimension:].shape)
    steps[bodies.graph.index(bodies.graph.gauge)] = 0
    turned = lie.retract(bodies.graph.poses, steps)
    back = bodies.moved(bodies.expanded(turned))
    assert lie.local(turned, back)[:, dimension:] == pytest.approx(0, abs=1e-9)
    # Opposite rotations of two nodes cancel; what is fixed stays.
    pair = masat.PoseGraph.from_arrays(
        [[0, 1], [1, 2]], poses=np.zeros((3, 3)), measurements=np.zeros((2, 3))
    )
    both = rigid_bodies(pair, np.array([False, True]))
    assert both.moved(np.array([[0, 0, 0.5], [0, 0, 0.3], [0, 0, -0.3]])) == pytest.approx(0)


@pytest.mark.parametrize("dimension", [2, 3])
def test_after_a_projected_step_the_translations_are_the_best(dimension):
    graph = random_graph(dimension, 30, 40, seed=4, noise=0.3)
    plain = normal_equations(graph)
    projected = ProjectedEquations(graph, plain)
    plain.linearize(graph.poses)
    assert plain.factorize(np.zeros_like(plain.rhs())) < 0
    step = plain.solve()
    moved, better = plain.retract(graph.poses, step), projected.retract(graph.poses, step)
    assert plain.chi2(better) < plain.chi2(moved)
    assert lie.local(moved, better)[:, dimension:] == pytest.approx(0, abs=1e-12)
    assert solve_translations(graph, better) == pytest.approx(better, abs=1e-6)
    found = masat.optimize(graph, "dogleg", equations=projected)
    assert found.chi2 == pytest.approx(masat.optimize(graph, "dogleg").chi2)


def test_translations_that_nothing_determines_stay_after_a_projected_step():
    graph = masat.PoseGraph.from_arrays(
        [[0, 1]], np.zeros((1, 3)), np.diag([0.0, 0.0, 1.0])[None], poses=np.zeros((2, 3))
    )
    projected = ProjectedEquations(graph, normal_equations(graph))
    moved = projected.retract(graph.poses, np.array([1.0, 2.0, 0.5]))
    assert moved[1] == pytest.approx([1.0, 2.0, 0.5])


def test_a_loss_takes_the_normal_equations_of_a_graph_alone():
    graph = random_graph(2, 10, 10, seed=1, noise=0.1)
    projected = ProjectedEquations(graph, normal_equations(graph))
    with pytest.raises(masat.OptimizationError, match="normal equations"):
        masat.optimize(graph, loss="huber", equations=projected)
