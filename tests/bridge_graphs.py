"""Graphs that tests hand over bridges, and what they ask of them."""

import numpy as np
import pytest

import masat
from masat import PoseGraph, lie
from masat.worlds import manhattan, perturb, sphere

DIMENSIONS = pytest.mark.parametrize("d", [2, 3])


def correlated(d, count, seed=0):
    """Positive definite matrices whose entries all differ."""
    dof = lie.DOF[d]
    a = np.random.default_rng(seed).normal(size=(count, dof, dof))
    return a @ a.transpose(0, 2, 1) * 10 + np.eye(dof)


def graph_of(d, sigma=0.1, **more):
    """A noisy graph with correlated information and ids that have gaps."""
    world = perturb(manhattan(30, 50, extent=4, seed=1), (sigma, sigma, sigma / 2), seed=1)
    if d == 3:
        world = perturb(sphere(30, 60, seed=1), (sigma, sigma / 2), seed=1)
    ids = 5 + 3 * world.ids
    given = {"poses": masat.initialize(world, "odometry").poses, "fixed": [5]} | more
    return PoseGraph.from_arrays(
        5 + 3 * world.edges, world.measurements, correlated(d, len(world.edges)), ids=ids, **given
    )


def rich(d):
    """All that a graph can hold."""
    graph = graph_of(d)
    rng = np.random.default_rng(3)
    at = lie.retract(graph.poses[:4], 0.1 * rng.normal(size=(4, lie.DOF[d])))
    seen = masat.landmarks(
        [(5, 1000), (8, 1000), (8, 1001)],
        rng.normal(size=(3, d)),
        positions=rng.normal(size=(2, d)),
    )
    ranges = masat.range_bearing([(11, 1001)], [2.0], sigma_range=0.1, dimension=d)
    return PoseGraph.from_arrays(
        graph.edges,
        graph.measurements,
        graph.information,
        ids=graph.ids,
        poses=graph.poses,
        fixed=[5, 11],
        notes=["repaired"],
        labels=[f"sensor {k % 3}" for k in range(len(graph.edges))],
        stamps=10**18 + np.arange(len(graph)),
        priors=[
            masat.pose_priors(graph.ids[:4], at, correlated(d, 4, 5), offset=at[0]),
            masat.gps([8], np.ones((1, d)), 0.5),
        ],
        landmarks=[seen, ranges],
    )


def assert_same(graph, other, tolerance=1e-12):
    """Everything of two graphs is equal, poses and information to a tolerance."""
    for name in ("ids", "edges", "fixed"):
        assert np.array_equal(getattr(graph, name), getattr(other, name)), name
    assert graph.notes == other.notes
    for name in ("labels", "stamps"):
        one, two = getattr(graph, name), getattr(other, name)
        assert (one is None) == (two is None), name
        if one is not None:
            assert one.dtype.kind == two.dtype.kind
            assert (one == two).all()
    assert (graph.poses is None) == (other.poses is None)
    if graph.poses is not None:
        assert_poses(graph.poses, other.poses, tolerance)
    assert_poses(graph.measurements, other.measurements, tolerance)
    assert_matrices(graph.information, other.information, tolerance)
    for name in ("priors", "landmarks"):
        one, two = getattr(graph, name), getattr(other, name)
        assert (one is None) == (two is None), name
    if graph.priors is not None:
        one, two = graph.priors, other.priors
        assert np.array_equal(one.ids, two.ids)
        assert_poses(one.measurements, two.measurements, tolerance)
        assert_matrices(one.information, two.information, tolerance)
        assert (one.offsets is None) == (two.offsets is None)
        if one.offsets is not None:
            assert_poses(one.offsets, two.offsets, tolerance)
    if graph.landmarks is not None:
        one, two = graph.landmarks, other.landmarks
        for name in ("ids", "positions", "observations"):
            assert np.array_equal(getattr(one, name), getattr(two, name)), name
        assert np.abs(one.measurements - two.measurements).max(initial=0) <= tolerance
        assert_matrices(one.information, two.information, tolerance)
        assert np.array_equal(one.is_range_bearing, two.is_range_bearing)


def assert_poses(one, two, tolerance):
    assert np.abs(lie.local(one, two)).max(initial=0) <= tolerance * max(1, np.abs(one).max())


def assert_matrices(one, two, tolerance):
    scale = np.abs(one).max(axis=(1, 2), keepdims=True)
    assert (np.abs(one - two) <= tolerance * scale).all()
