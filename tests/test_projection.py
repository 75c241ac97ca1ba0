"""Steps after which the translations are solved for anew."""

import numpy as np
import pytest
from random_graphs import random_graph

import masat
from masat import lie
from masat.assembly import assemble
from masat.optimizers.equations import normal_equations
from masat.optimizers.projection import ProjectedEquations
from masat.optimizers.translations import BestTranslations, solve_translations
from masat.worlds import WORLDS, perturb


def isotropic(dimension, seed):
    graph = random_graph(dimension, 30, 40, seed=seed, noise=0.3)
    information = np.zeros_like(graph.information)
    random = np.random.default_rng(seed)
    weights = random.uniform(0.5, 2.0, len(graph.edges))
    information[:, range(dimension), range(dimension)] = weights[:, None]
    information[:, dimension:, dimension:] = graph.information[:, dimension:, dimension:]
    return masat.PoseGraph.from_arrays(
        graph.edges, graph.measurements, information, poses=graph.poses, fixed=[3, 17]
    )


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("kind", [isotropic, lambda d, s: random_graph(d, 30, 40, s, noise=0.3)])
def test_the_best_translations_are_those_of_a_solve(kind, dimension):
    graph = kind(dimension, 4)
    best = BestTranslations(graph)
    for seed in range(3):
        steps = np.random.default_rng(seed).normal(size=(30, lie.DOF[dimension]))
        steps[graph.index(graph.gauge)] = 0
        poses = lie.retract(graph.poses, 0.4 * steps)
        assert best(poses) == pytest.approx(solve_translations(graph, poses), abs=1e-9)


def test_the_best_translations_with_sensors_off_the_nodes():
    graph = perturb(WORLDS["manhattan"](40, 60, seed=2), (0.1, 0.1, 0.1), seed=1)
    fixes = masat.gps([3, 30], [[1.0, 2.0], [4.0, 3.0]], 0.5, lever_arm=[0.2, 0.1])
    whole = assemble(graph.with_priors(fixes)).graph
    there = BestTranslations(whole)(whole.poses)
    assert there == pytest.approx(solve_translations(whole, whole.poses))
    assert whole.with_poses(there).chi2 < whole.chi2


@pytest.mark.parametrize("dimension", [2, 3])
def test_after_a_projected_step_the_translations_are_the_best(dimension):
    graph = random_graph(dimension, 30, 40, seed=4, noise=0.3)
    plain = normal_equations(graph)
    projected = ProjectedEquations(plain, BestTranslations(graph))
    plain.linearize(graph.poses)
    assert plain.factorize(np.zeros_like(plain.rhs())) < 0
    step = plain.solve()
    moved, better = plain.retract(graph.poses, step), projected.retract(graph.poses, step)
    assert plain.chi2(better) < plain.chi2(moved)
    assert lie.local(moved, better)[:, dimension:] == pytest.approx(0, abs=1e-12)
    assert solve_translations(graph, better) == pytest.approx(better, abs=1e-6)
    found = masat.optimize(graph, "dogleg", equations=projected)
    assert found.chi2 == pytest.approx(masat.optimize(graph, "dogleg").chi2)


def test_projected_steps_are_few_where_a_map_has_to_turn():
    """Half of a long corridor points the wrong way: its nodes move along arcs."""
    count = 400
    edges = [(k, k + 1) for k in range(count - 1)]
    straight = np.column_stack([np.arange(count), np.zeros((count, 2))])
    graph = masat.PoseGraph.from_arrays(edges, np.tile([1.0, 0.0, 0.0], (count - 1, 1)))
    bent = straight.copy()
    bent[count // 2 :, 2] = 2.5
    steps = {}
    for name, equations in (
        ("plain", normal_equations(graph)),
        (
            "projected",
            ProjectedEquations(normal_equations(graph), BestTranslations(graph.with_poses(bent))),
        ),
    ):
        found = masat.optimize(graph.with_poses(bent), "dogleg", equations=equations)
        assert found.chi2 < 1e-9
        steps[name] = len(found.history)
    assert 2 * steps["projected"] < steps["plain"]


@pytest.mark.parametrize("rows", [[0.0, 0.0, 1.0], [1.0, 0.0, 1.0]])
def test_what_nothing_determines_has_no_best_translation(rows):
    graph = masat.PoseGraph.from_arrays(
        [[0, 1]], np.zeros((1, 3)), np.diag(rows)[None], poses=np.zeros((2, 3))
    )
    with pytest.raises(masat.InitializationError, match="position"):
        BestTranslations(graph)(graph.poses)


def test_a_step_stays_plain_where_nothing_determines_a_translation():
    graph = masat.PoseGraph.from_arrays(
        [[0, 1]], np.zeros((1, 3)), np.diag([0.0, 0.0, 1.0])[None], poses=np.zeros((2, 3))
    )
    projected = ProjectedEquations(normal_equations(graph), BestTranslations(graph))
    assert projected.retract(graph.poses, np.array([1.0, 2.0, 0.5]))[1] == pytest.approx(
        [1, 2, 0.5]
    )


def test_a_loss_takes_the_normal_equations_of_a_graph_alone():
    graph = random_graph(2, 10, 10, seed=1, noise=0.1)
    projected = ProjectedEquations(normal_equations(graph), BestTranslations(graph))
    with pytest.raises(masat.OptimizationError, match="normal equations"):
        masat.optimize(graph, loss="huber", equations=projected)
