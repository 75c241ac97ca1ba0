"""Linearization, cost and substitution in groups and chunks: their sums, with any threads."""

import numpy as np
import pytest

from masat import PoseGraph, lie
from masat._core import Elimination, Loss, LossKind, NormalEquations, Topology
from masat.worlds import city, perturb, sphere

NO_ORDER = np.empty(0, np.int32)
# The first node, and some others: edges that end at them, and edges between two of them.
FIXED = (0, 700, 701)


def large_graph(dimension):
    """A graph whose edges make several groups, some of them twice or the other way round."""
    world = city(5000, seed=1) if dimension == 2 else sphere(1600, seed=1)
    graph = perturb(world, 0.02 * np.ones(lie.DOF[dimension]), seed=1)
    random = np.random.default_rng(1)
    again = random.choice(len(graph.edges), 300, replace=False)
    edges = np.concatenate([graph.edges, graph.edges[again[:150]], graph.edges[again[150:], ::-1]])
    z = np.concatenate([graph.measurements, graph.measurements[again]])
    dof = lie.DOF[dimension]
    root = random.normal(size=(len(edges), dof, dof))
    information = root @ root.transpose(0, 2, 1) + np.eye(dof)
    return PoseGraph.from_arrays(edges, z, information, ids=graph.ids, poses=graph.poses)


def sensors_of(graph):
    """Offsets of sensors, and flags of edges that measure range and bearing."""
    random = np.random.default_rng(2)
    noise = 0.1 * random.normal(size=(len(graph.edges), lie.DOF[graph.dimension]))
    offsets = lie.retract(np.tile(lie.identity(graph.dimension), (len(noise), 1)), noise)
    return {"offsets": offsets, "range_bearing": random.random(len(noise)) < 0.3}


def equations_of(graph, threads, rows, sensors):
    fixed = np.zeros(len(graph.ids), bool)
    fixed[list(FIXED)] = True
    topology = Topology(len(graph.ids), np.ascontiguousarray(graph.edge_indices[rows]))
    return NormalEquations(
        topology,
        Elimination(topology, fixed, NO_ORDER),
        graph.measurements[rows],
        graph.information[rows],
        threads,
        **{name: values[rows] for name, values in sensors.items()},
    )


def linearized(graph, equations, rows, kind):
    """Linearize with one kind of weights; return both costs."""
    random = np.random.default_rng(3)
    weights, trusted = random.random(len(graph.edges))[rows], random.random(len(graph.edges)) < 0.5
    if kind == "weighted":
        return equations.linearize(graph.poses, weights), equations.chi2(graph.poses)
    if kind == "robust":
        loss = Loss(LossKind.CAUCHY, 2.0)
        return (
            equations.linearize_robust(graph.poses, loss, trusted[rows]),
            equations.robust_cost(graph.poses, loss, trusted[rows]),
        )
    return equations.linearize(graph.poses), equations.chi2(graph.poses)


def system(graph, equations):
    """Everything that a linearization sets, and a product with it."""
    v = np.cos(np.arange(len(equations.rhs())))
    return equations.rhs(), equations.diagonal(), equations.multiply(v)


KINDS = ["plain", "weighted", "robust", "sensors"]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("dimension", [2, 3])
def test_groups_of_edges_sum_to_the_system_of_all(dimension, kind):
    graph = large_graph(dimension)
    sensors = sensors_of(graph) if kind == "sensors" else {}
    whole = equations_of(graph, 1, slice(None), sensors)
    cost, again = linearized(graph, whole, slice(None), kind)
    found = system(graph, whole)
    # So few edges that each part is one group: there the edges are added one by one.
    costs, sums = 0.0, [np.zeros_like(values) for values in found]
    for part in np.array_split(np.random.default_rng(5).permutation(len(graph.edges)), 12):
        equations = equations_of(graph, 1, part, sensors)
        costs += linearized(graph, equations, part, kind)[0]
        for total, values in zip(sums, system(graph, equations), strict=True):
            total += values
    assert np.isclose(cost, costs, rtol=1e-12)
    assert kind == "weighted" or np.isclose(again, costs, rtol=1e-12)
    for values, total in zip(found, sums, strict=True):
        assert np.allclose(values, total, rtol=1e-10, atol=1e-10 * np.abs(total).max())


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("dimension", [2, 3])
def test_an_iteration_has_the_same_bits_with_any_number_of_threads(dimension, kind):
    graph = large_graph(dimension)
    sensors = sensors_of(graph) if kind == "sensors" else {}
    found = []
    for threads in (1, 2, 3):
        equations = equations_of(graph, threads, slice(None), sensors)
        for _ in range(2):  # a second time nothing is left of the first
            costs = linearized(graph, equations, slice(None), kind)
            assert equations.factorize(np.full(len(equations.rhs()), 1e-3)) == -1
            step = equations.solve()
        moved = equations.retract(graph.poses, step)
        found.append([*costs, *system(graph, equations), step, moved])
    assert (found[0][-1][list(FIXED)] == graph.poses[list(FIXED)]).all()
    for others in found[1:]:
        for one, other in zip(found[0], others, strict=True):
            assert np.array_equal(one, other)


@pytest.mark.parametrize("dimension", [2, 3])
def test_the_step_solves_the_system(dimension):
    graph = large_graph(dimension)
    equations = equations_of(graph, 2, slice(None), {})
    equations.linearize(graph.poses)
    assert equations.factorize(np.zeros(len(equations.rhs()))) == -1
    rhs = equations.rhs()
    assert np.abs(equations.multiply(equations.solve()) - rhs).max() < 1e-9 * np.abs(rhs).max()
