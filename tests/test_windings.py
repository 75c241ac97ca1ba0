import numpy as np
import pytest
from random_graphs import random_graph

import masat
from masat import PoseGraph, lie, windings
from masat.study.names import Case
from masat.study.trial import instance


def ring(count, dimension, axis=(0.0, 0.0, 1.0), turns=0):
    """Exact measurements along a closed polygon, and poses whose rotations go round once more."""
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
    # Rotations well known, positions hardly: nothing but the rotations holds the ring.
    information = np.diag([1e-4] * dimension + [100.0] * (3 if dimension == 3 else 1))
    return PoseGraph.from_arrays(
        np.column_stack([start, end]),
        lie.between(truth[start], truth[end]),
        information,
        poses=lie.compose(truth, twist),
    )


def chi2(graph, poses):
    return masat.optimize(graph.with_poses(poses), max_iterations=0).chi2


@pytest.mark.parametrize(
    ("dimension", "axis"), [(2, None), (3, (0, 0, 1)), (3, (1, 0, 0)), (3, (0.6, 0.0, 0.8))]
)
@pytest.mark.parametrize("turns", [1, -1, 0])
def test_a_ring_turned_once_too_often_is_turned_back(dimension, axis, turns):
    graph = ring(24, dimension, axis, turns)
    local = masat.optimize(graph)
    if turns:
        assert local.chi2 > 40  # 24 errors of 15 degrees
    unwound = windings.unwind(local.graph)
    assert unwound.turns == abs(turns)
    assert chi2(graph, unwound.poses) < 1e-9
    assert (unwound.poses[0] == local.graph.poses[0]).all()


def test_edges_of_a_ring_share_a_turn():
    graph = ring(10, 2, turns=0)
    loops = windings._Loops(graph)
    assert np.allclose(loops._slack, 0.1)
    turned = loops.response(3)
    shared = turned[graph.edge_indices[:, 1]] - turned[graph.edge_indices[:, 0]]
    shared[3] -= 2 * np.pi
    assert np.allclose(shared, -2 * np.pi / 10)


def test_a_ring_promises_what_the_turn_brings():
    graph = ring(24, 2, turns=1)
    (loop,) = windings._Loops(graph).promising(graph.poses, 1.0)
    assert np.isclose(loop.error, 2 * np.pi / 24)
    # Of 100 * 24 * (2 pi / 24)^2 nothing is left: 100 * 4 pi (pi / 24 - 2 pi / 24).
    assert np.isclose(chi2(graph, graph.poses), 100 * 4 * np.pi * np.pi / 24, rtol=1e-4)


def test_a_good_map_stays_as_it_is():
    graph = random_graph(2, 30, 60, seed=1, noise=0.02)
    best = masat.optimize(graph).graph
    unwound = windings.unwind(best)
    assert unwound.turns == 0
    assert (unwound.poses == best.poses).all()


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("dimension", [2, 3])
def test_chi2_never_rises_and_anchors_hold_still(dimension, seed):
    graph = random_graph(dimension, 40, 50, seed=seed, noise=0.4)
    start = masat.optimize(masat.initialize(graph, "spanning_tree"))
    unwound = windings.unwind(start.graph)
    assert chi2(graph, unwound.poses) <= start.chi2 * (1 + 1e-9)
    held = graph.index(graph.anchors)
    assert (unwound.poses[held] == start.graph.poses[held]).all()
    again = windings.unwind(start.graph)
    assert (again.poses == unwound.poses).all()


def test_a_twist_between_fixed_nodes_is_turned_back():
    """Where several nodes are fixed, none of them may turn."""
    whole = ring(24, 2, turns=1)
    # Nodes 0 and 12 are held where the twist has made half a turn: so must the way between them.
    fixed = PoseGraph.from_arrays(
        whole.edges, whole.measurements, whole.information, poses=whole.poses, fixed=[0, 12]
    )
    unwound = windings.unwind(fixed)
    assert (unwound.poses[[0, 12]] == whole.poses[[0, 12]]).all()
    assert chi2(fixed, unwound.poses) <= chi2(fixed, whole.poses)


def test_components_are_unwound_each_for_itself():
    one = ring(24, 2, turns=1)
    both = PoseGraph.from_arrays(
        np.concatenate([one.edges, one.edges + 100]),
        np.concatenate([one.measurements, one.measurements]),
        one.information[0],
        poses=np.concatenate([one.poses, one.poses]),
    )
    local = masat.optimize(both)
    unwound = windings.unwind(local.graph)
    assert unwound.turns == 2
    assert chi2(both, unwound.poses) < 1e-9


@pytest.mark.parametrize("name", ["Manhattan3500/28", "City10k/15"])
def test_local_minima_of_the_study_are_left(name, data_dir, monkeypatch):
    """At .35 m and rad, where the chordal start leads above what the truth leads to."""
    monkeypatch.setenv("MASAT_DATASETS", str(data_dir))
    world, number = name.split("/")
    graph = instance(Case(world, (0.35, 0.35, 0.35), int(number)))
    control = masat.optimize(graph)
    local = masat.optimize(masat.initialize(graph, "chordal"))
    assert local.chi2 > control.chi2 * (1 + 1e-4)
    unwound = windings.unwind(local.graph)
    assert unwound.turns > 0
    assert chi2(graph, unwound.poses) <= control.chi2 * (1 + 1e-6)
