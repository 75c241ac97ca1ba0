"""Covariances along odometry in runs that few edges join are those of the linear system."""

import numpy as np
import pytest
from random_graphs import random_poses

import masat
from masat import lie
from masat.covariance import relative_covariances
from masat.robust.odometry_sums import carried, odometry_sums


def graph_of_runs(d, joining, n=30, cuts=(10, 18, 19), seed=0):
    """Return a graph of four runs of odometry and edges that join them, at its measurements."""
    rng = np.random.default_rng(seed)
    chain = [(k, k + 1) for k in range(n - 1) if k + 1 not in cuts]
    edges = np.array(chain + list(joining))
    poses = random_poses(d, n, rng)
    root = rng.normal(size=(len(edges), lie.DOF[d], lie.DOF[d]))
    graph = masat.PoseGraph.from_arrays(
        edges=edges,
        measurements=lie.between(poses[edges[:, 0]], poses[edges[:, 1]]),
        information=root @ root.transpose(0, 2, 1) + np.eye(lie.DOF[d]),
        ids=np.arange(n),
    )
    return graph.with_poses(poses)


@pytest.mark.parametrize("d", [2, 3])
def test_sums_are_the_covariances_of_the_system(d):
    graph = graph_of_runs(d, [(12, 3), (25, 16), (18, 27)])
    a, b = (ends.ravel() for ends in np.meshgrid(np.arange(30), np.arange(30)))
    along = odometry_sums(graph)
    total, apart = along.between(a, b)
    assert len(apart) == 0
    seen = carried(total, lie.between(graph.poses[b], along.center))
    expected = relative_covariances(graph, np.stack([a, b], 1))
    assert np.allclose(seen, expected, rtol=1e-7, atol=1e-8 * np.abs(expected).max())


def test_what_no_edge_joins_has_no_sum():
    graph = graph_of_runs(2, [(12, 3)])
    total, apart = odometry_sums(graph).between(np.array([0, 0, 11]), np.array([11, 20, 18]))
    assert apart.tolist() == [1, 2]
    assert total[0].any()


@pytest.mark.parametrize("joining", [[(0, 1)], [(12, 3), (13, 4)]])
def test_edges_that_make_a_cycle_have_no_sums(joining):
    assert odometry_sums(graph_of_runs(2, joining)) is None
