import numpy as np
import pytest

import masat
from masat import PoseGraph, lie
from masat.optimality import search as searching
from masat.optimality.cycles import AmbiguousCycles
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
    monkeypatch.setattr(searching, "lift", lambda part, **_: part.poses)
    search = searching._Search(graph, 0, Progress(), normal_equations(graph))
    return search, search.at_cycles()


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
