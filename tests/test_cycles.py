from itertools import pairwise

import numpy as np
import pytest

import masat
from masat import PoseGraph, lie
from masat.optimality import search as searching
from masat.optimality import trials
from masat.optimality.cycles import LONG, AmbiguousCycles, cut_edges, shifted
from masat.optimizers.equations import normal_equations
from masat.progress import Progress


def ring(count, dimension, axis=(0.0, 0.0, 1.0), turns=0):
    """Exact measurements along a closed polygon, and poses whose rotations rotate once more."""
    angles = 2 * np.pi * np.arange(count) / count
    if dimension == 2:
        truth = np.column_stack([np.cos(angles), np.sin(angles), angles + np.pi / 2])
        twist = np.column_stack([np.zeros((count, 2)), turns * angles])
    else:
        truth = np.tile(lie.identity(3), (count, 1))
        truth[:, :2] = np.column_stack([np.cos(angles), np.sin(angles)])
        twist = np.tile(lie.identity(3), (count, 1))
        twist[:, 3:6] = np.sin(turns * angles / 2)[:, None] * np.array(axis)
        twist[:, 6] = np.cos(turns * angles / 2)
    start = np.arange(count)
    end = np.roll(start, -1)
    # Rotations well known, positions hardly: the rotations decide.
    information = np.diag([1e-4] * dimension + [100.0] * (3 if dimension == 3 else 1))
    return PoseGraph.from_arrays(
        np.column_stack([start, end]),
        lie.between(truth[start], truth[end]),
        information,
        poses=lie.compose(truth, twist),
    )


def chi2(graph, poses):
    return masat.optimize(graph.with_poses(poses), max_iterations=0).chi2


def shift_cycles(graph, monkeypatch):
    """Return what shifts alone make of a graph."""
    monkeypatch.setattr(trials, "lift", lambda part, **_: part.poses)
    search = searching._Search(graph, 0, Progress(), normal_equations(graph))
    return search, search.at_cycles(search.doubtful_nodes())


@pytest.mark.parametrize(
    ("dimension", "axis"), [(2, None), (3, (0, 0, 1)), (3, (1, 0, 0)), (3, (0.6, 0.0, 0.8))]
)
@pytest.mark.parametrize("turns", [1, -1, 0])
def test_a_ring_with_a_wrong_winding_number_is_shifted_back(dimension, axis, turns, monkeypatch):
    graph = ring(24, dimension, axis, turns)
    local = masat.optimize(graph)
    if turns:
        assert local.chi2 > 40  # 24 errors of 15 degrees
    search, lower = shift_cycles(local.graph, monkeypatch)
    assert lower == (turns != 0)
    assert chi2(graph, search.poses) < 1e-9
    assert np.isclose(search.chi2, chi2(graph, search.poses), atol=1e-9)
    assert (search.poses[0] == local.graph.poses[0]).all()


def test_edges_of_a_ring_share_a_shift():
    graph = ring(10, 2, turns=0)
    cycles = AmbiguousCycles(graph)
    assert np.allclose(cycles._kept, 0.1)
    rotations = cycles.rotations(3)
    shared = rotations[graph.edge_indices[:, 1]] - rotations[graph.edge_indices[:, 0]]
    shared[3] -= 2 * np.pi
    assert np.allclose(shared, -2 * np.pi / 10)


def test_a_ring_promises_what_the_shift_gains():
    graph = ring(24, 2, turns=1)
    cycles = AmbiguousCycles(graph)
    assert sorted(cycles.edges(graph.poses)) == list(range(24))
    (cycle,) = cycles.at(graph.poses)
    assert np.isclose(cycle.residual, 2 * np.pi / 24)
    # Of 100 * 24 * (2 pi / 24)^2 nothing is left: 100 * 4 pi (pi / 24 - 2 pi / 24).
    assert np.isclose(chi2(graph, graph.poses), 100 * 4 * np.pi * np.pi / 24, rtol=1e-4)


def test_a_twist_between_fixed_nodes_is_shifted_back(monkeypatch):
    """Where several nodes are fixed, none of them may rotate: the chain between them does."""
    whole = ring(24, 2)
    # The twist is within nodes 0 to 20, and these two have the poses that they should have.
    twist = np.append(2 * np.pi * np.arange(21) / 20, [0.0, 0.0, 0.0])
    poses = whole.poses + np.column_stack([np.zeros((24, 2)), twist])
    poses[20] = whole.poses[20]
    fixed = PoseGraph.from_arrays(
        whole.edges, whole.measurements, whole.information, poses=poses, fixed=[0, 20]
    )
    local = masat.optimize(fixed)
    assert local.chi2 > 40
    search, lower = shift_cycles(local.graph, monkeypatch)
    assert lower
    assert search.chi2 < 1e-9
    assert (search.poses[[0, 20]] == whole.poses[[0, 20]]).all()


def test_each_component_is_shifted_by_itself(monkeypatch):
    one = ring(24, 2, turns=1)
    both = PoseGraph.from_arrays(
        np.concatenate([one.edges, one.edges + 100]),
        np.concatenate([one.measurements, one.measurements]),
        one.information[0],
        poses=np.concatenate([one.poses, one.poses]),
    )
    local = masat.optimize(both)
    search, lower = shift_cycles(local.graph, monkeypatch)
    assert lower
    assert search.chi2 < 1e-9
    held = both.index(both.gauge)
    assert (search.poses[held] == local.graph.poses[held]).all()


@pytest.mark.parametrize(
    ("dimension", "axis"), [(2, None), (3, (0, 0, 1)), (3, (1, 0, 0)), (3, (0.6, 0.0, 0.8))]
)
def test_spreading_a_shift_anew_undoes_a_twist(dimension, axis):
    graph = ring(24, dimension, axis, turns=1)
    (cycle,) = AmbiguousCycles(graph).at(graph.poses)
    shifts = np.zeros((24, 1 if dimension == 2 else 3))
    shifts[cycle.edge] = -2 * np.pi * cycle.axis
    assert chi2(graph, shifted(graph, shifts)) < 1e-9
    # Without a shift each edge keeps its part, since all have the same weight.
    same = shifted(graph, 0 * shifts)
    assert np.isclose(chi2(graph, same), chi2(graph, graph.poses))


def test_a_pair_of_rings_that_share_edges_is_tried_together():
    """Three chains of twelve edges between two nodes; the rotations along one go once around."""
    chains = [[0, *range(2 + 11 * k, 13 + 11 * k), 1] for k in range(3)]
    edges = [pair for chain in chains for pair in pairwise(chain)]
    poses = np.zeros((35, 3))
    poses[chains[0], 2] = 2 * np.pi * np.arange(13) / 12
    graph = PoseGraph.from_arrays(
        edges, np.zeros((36, 3)), np.diag([1e-4, 1e-4, 100.0]), poses=poses
    )
    cycles = AmbiguousCycles(graph)
    found = list(cycles.at(poses))
    assert [cycle.edges.tolist() for cycle in found] == [list(range(12))]
    assert np.isclose(found[0].cost, 4 * np.pi * 100 * (np.pi / 18 - np.pi / 6))
    assert cycles.pairs(found) == []
    # A shift costs the same with the sign that undoes it, and one chain is shared by both cycles.
    both = [found[0], found[0]._replace(edge=12, axis=-found[0].axis)]
    both[1] = both[1]._replace(rotations=cycles.rotations(12))
    assert len(cycles.pairs(both)) == 1


def test_long_cycles_are_cut_at_a_few_edges():
    assert (
        len(cut_edges(next(AmbiguousCycles(ring(24, 2, turns=1)).at(ring(24, 2, turns=1).poses))))
        == 0
    )
    graph = ring(2 * LONG, 2, turns=1)
    (cycle,) = AmbiguousCycles(graph).at(graph.poses)
    cuts = cut_edges(cycle)
    assert len(cuts) == 4
    assert set(cuts) <= set(cycle.edges)
    assert {cuts[0], cuts[-1]} == {cycle.edges[0], cycle.edges[-1]}


@pytest.mark.parametrize("seed", range(12))
def test_a_long_loop_ends_at_the_best_of_all_winding_numbers(seed):
    truth = ring(60, 2).with_poses(ring(60, 2).poses)
    random = np.random.default_rng(seed)
    noisy = truth.measurements + random.normal(size=(60, 3)) * [0.01, 0.01, 0.3]
    information = np.diag([1e4, 1e4, 1 / 0.09])
    graph = PoseGraph.from_arrays(truth.edges, noisy, information)
    odometry = masat.initialize(graph, "odometry")
    best = np.inf
    end = lie.between(odometry.poses[-1:], odometry.poses[:1])
    gap = lie.local(noisy[-1:], end)[0, 2]
    for turns in range(-2, 3):
        angles = -(gap + 2 * np.pi * turns) * np.arange(60) / 60
        poses = odometry.poses.copy()
        poses[:, 2] += np.where(np.isfinite(angles), angles, 0)
        for method in ("dogleg", "gauss_newton"):
            best = min(best, masat.optimize(graph.with_poses(poses), method).chi2)
    assert masat.solve(graph).chi2 <= best * (1 + 1e-6)
