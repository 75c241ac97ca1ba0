"""The bridge to gtsam: round trips without loss, and clear words where there would be one.

Skipped without gtsam; `make test-bridges` installs it.
"""

import numpy as np
import pytest
from bridge_graphs import (
    DIMENSIONS,
    assert_matrices,
    assert_poses,
    assert_same,
    correlated,
    graph_of,
)
from random_graphs import random_graph

import masat
from masat import GraphError, MasatWarning, PoseGraph, lie
from masat.bridges.gtsam import from_gtsam, to_gtsam
from masat.worlds import add_landmarks

gtsam = pytest.importorskip("gtsam", reason="gtsam is not installed: make test-bridges")


@DIMENSIONS
def test_gtsam_holds_poses_edges_and_fixed_nodes(d):
    graph = graph_of(d, fixed=[5, 11])
    assert_same(graph, from_gtsam(*to_gtsam(graph)))
    assert_same(
        graph_of(d, fixed=(), poses=None), from_gtsam(*to_gtsam(graph_of(d, fixed=(), poses=None)))
    )


@DIMENSIONS
def test_gtsam_holds_priors(d):
    graph = graph_of(d, fixed=())
    node = graph.ids[3]
    kinds = [
        masat.pose_priors([5, 8], graph.poses[:2], correlated(d, 2, 5)),
        masat.gps([node], np.arange(d, dtype=float)[None], np.arange(1.0, d + 1)),
    ]
    kinds.append(
        masat.headings([node], [1.0], 0.1) if d == 2 else masat.altitudes([node], [4.0], 0.1)
    )
    graph = graph.with_priors(kinds)
    assert_same(graph, from_gtsam(*to_gtsam(graph)))


def with_sights(graph):
    """The graph with ranges and bearings of landmarks, together and alone."""
    d = graph.dimension
    points = np.random.default_rng(0).normal(0, 3, (3, d))
    pairs = np.array([(node, 1000 + k) for node in graph.ids[:8] for k in range(3)])
    own = lie.to_matrices(lie.inverse(graph.poses[graph.index(pairs[:, 0])]))
    local = np.einsum("kij,kj->ki", own[:, :d, :d], points[pairs[:, 1] - 1000]) + own[:, :d, d]
    ranges, bearings = np.linalg.norm(local, axis=1), np.arctan2(local[:, 1], local[:, 0]) * 0.99
    up = np.arcsin(local[:, 2] / ranges) if d == 3 else None
    positions = {"ids": [1000, 1001, 1002], "positions": points, "dimension": d}
    near = {"sigma_range": 0.1, "sigma_bearing": 0.02}
    return graph.with_landmarks(
        [
            masat.range_bearing(pairs, 1.01 * ranges, bearings, up, **near, **positions),
            masat.range_bearing(pairs[::3], ranges[::3], sigma_range=0.2, **positions),
            masat.range_bearing(
                pairs[::4],
                bearings=bearings[::4],
                elevations=None if up is None else up[::4],
                sigma_bearing=0.1,
                **positions,
            ),
        ]
    ).with_priors(
        [masat.gps([1001], points[1:2], 0.5), masat.gps(graph.ids[:1], np.ones((1, d)), 1)]
    )


@DIMENSIONS
def test_gtsam_holds_ranges_and_bearings(d):
    graph = with_sights(graph_of(d, fixed=()))
    assert_same(graph, from_gtsam(*to_gtsam(graph)))
    # Their residuals are the same ones, but for the second order.
    factors, values = to_gtsam(graph)
    own = 2 * factors.error(values) - 2 * to_gtsam(
        graph.with_priors(None).with_landmarks(None)
    ).graph.error(values)
    assert own == pytest.approx(graph.chi2 - graph.chi2_per_edge.sum(), rel=1e-3)


def test_correlated_directions_in_3d_are_refused():
    graph = graph_of(3, fixed=())
    flat = masat.range_bearing(
        [(5, 1000)], [3.0], [0.1], [0.2], sigma_range=1, sigma_bearing=1, sigma_elevation=2
    )
    with pytest.raises(GraphError, match=r"observation 0 \(5 -> 1000\) has information on its dir"):
        to_gtsam(graph.with_landmarks(flat))


@DIMENSIONS
def test_small_residuals_cost_the_same_in_gtsam(d):
    """Information has the right order and scale: chi2 agrees to the first order of residuals."""
    graph = graph_of(d, fixed=())
    exact = lie.between(*graph.poses[graph.edge_indices].transpose(1, 0, 2))
    ratios = []
    for size in (1e-2, 1e-4):
        step = size * np.random.default_rng(0).normal(size=(len(exact), lie.DOF[d]))
        near = PoseGraph.from_arrays(
            graph.edges,
            lie.retract(exact, step),
            graph.information,
            ids=graph.ids,
            poses=graph.poses,
        )
        factors, values = to_gtsam(near)
        ratios.append(abs(2 * factors.error(values) / near.chi2 - 1))
    assert ratios[0] < 1e-2
    assert ratios[1] < 1e-4


@DIMENSIONS
def test_gtsams_optimum_is_near_ours(d):
    graph = graph_of(d, sigma=0.01, fixed=())
    graph = graph.with_priors(masat.gps(graph.ids[::4], graph.poses[::4, :d], 0.5))
    ours = masat.solve(graph).graph
    factors, values = to_gtsam(ours)
    theirs = gtsam.LevenbergMarquardtOptimizer(factors, values).optimize()
    moved = from_gtsam(factors, theirs)
    # The residuals of gtsam differ in the second order: its optimum is next to ours.
    assert 0 <= moved.chi2 / ours.chi2 - 1 < 1e-3
    assert 2 * factors.error(theirs) <= 2 * factors.error(values)
    assert 2 * factors.error(values) / ours.chi2 == pytest.approx(1, abs=0.05)


@DIMENSIONS
def test_gtsam_gets_a_gauge_on_request(d):
    graph = graph_of(d, sigma=0.01, fixed=())
    factors, values = to_gtsam(graph, fix_gauge=True)
    theirs = from_gtsam(factors, gtsam.GaussNewtonOptimizer(factors, values).optimize())
    assert theirs.fixed.tolist() == graph.gauge.tolist()
    assert_poses(theirs.poses[:1], graph.poses[:1], 1e-12)
    ours = masat.optimize(graph)
    assert 0 <= theirs.chi2 / ours.chi2 - 1 < 1e-3


@DIMENSIONS
def test_gtsams_own_file_reader_gives_the_same_edges(d, tmp_path):
    """But for the rotations in 3D, whose information it does not scale."""
    graph = graph_of(d, fixed=())
    masat.write(graph, tmp_path / "graph.g2o")
    read = from_gtsam(*gtsam.readG2o(str(tmp_path / "graph.g2o"), d == 3))
    assert np.array_equal(read.edges, graph.edges)
    assert_poses(graph.measurements, read.measurements, 1e-12)
    scale = np.array([1, 1, 1] if d == 2 else [1, 1, 1, 2, 2, 2])
    assert_matrices(graph.information, read.information / np.outer(scale, scale), 1e-9)


def test_gtsams_symbols_are_ids():
    a, b = gtsam.symbol("a", 3), gtsam.symbol("b", 1)
    graph = PoseGraph.from_arrays([(a, b)], [(1, 0, 0)])
    assert from_gtsam(*to_gtsam(graph)).edges.tolist() == [[a, b]]


@DIMENSIONS
def test_edges_of_rotations_alone_are_held(d):
    graph = graph_of(d, fixed=())
    information = graph.information.copy()
    information[7, :d] = information[7, :, :d] = 0
    graph = PoseGraph.from_arrays(graph.edges, graph.measurements, information, ids=graph.ids)
    assert_same(graph, from_gtsam(*to_gtsam(graph)))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda g: g.relabel(lambda ids: ids - 6), "there is a node -1"),
        (lambda g: add_landmarks(g, 3, seed=0), "observation 0 .* measures a position"),
        (
            lambda g: g.with_landmarks(masat.range_bearing([(5, -1)], [1.0], sigma_range=1.0)),
            "there is a landmark -1",
        ),
        (
            lambda g: g.with_priors(masat.gps([5], [(0, 0)], 1.0, lever_arm=(1, 0))),
            "sensor that is not at the node",
        ),
        (
            lambda g: PoseGraph.from_arrays(g.edges[:1], g.measurements[:1], np.diag([1, 1, 0])),
            "edge 5 -> 8 measures a translation and not the whole rotation",
        ),
        (
            lambda g: PoseGraph.from_arrays(g.edges, g.measurements, fixed=[5]),
            "node 5 cannot be fixed in gtsam without a pose",
        ),
    ],
)
def test_what_gtsam_cannot_hold_is_refused(change, message):
    graph = change(graph_of(2))
    with pytest.raises(GraphError, match=message):
        to_gtsam(graph)


def test_what_gtsam_has_no_field_for_is_told():
    with pytest.warns(MasatWarning, match="no field for the stamps of the nodes"):
        to_gtsam(graph_of(2).with_stamps(np.arange(30.0)))


def test_factors_without_a_counterpart_are_named():
    unit = gtsam.noiseModel.Unit.Create
    factors = gtsam.NonlinearFactorGraph()
    with pytest.raises(GraphError, match="no factor of a pose graph"):
        from_gtsam(factors)
    factors.add(gtsam.BetweenFactorPose2(0, 1, gtsam.Pose2(), unit(3)))
    factors.add(gtsam.RangeFactorPose2(0, 9, 1.0, unit(1)))
    with pytest.raises(GraphError, match=r"factor 1, a RangeFactorPose2 of the keys \[0, 9\]"):
        from_gtsam(factors)
    mixed = gtsam.NonlinearFactorGraph()
    mixed.add(gtsam.BetweenFactorPose2(0, 1, gtsam.Pose2(), unit(3)))
    mixed.add(gtsam.BetweenFactorPose3(0, 1, gtsam.Pose3(), unit(6)))
    with pytest.raises(GraphError, match="a BetweenFactorPose3, is in 3D"):
        from_gtsam(mixed)
    rigid = gtsam.NonlinearFactorGraph()
    rigid.add(gtsam.BetweenFactorPose2(0, 1, gtsam.Pose2(), gtsam.noiseModel.Constrained.All(3)))
    with pytest.raises(GraphError, match="constrained"):
        from_gtsam(rigid)
    large = gtsam.NonlinearFactorGraph()
    large.add(gtsam.BetweenFactorPose2(0, 2**63 + 1, gtsam.Pose2(), unit(3)))
    with pytest.raises(GraphError, match="has the key 9223372036854775809: ids are at most"):
        from_gtsam(large)
    fixed = gtsam.NonlinearFactorGraph()
    fixed.add(gtsam.NonlinearEqualityPose2(4, gtsam.Pose2()))
    with pytest.raises(GraphError, match="node 4 is fixed"):
        from_gtsam(fixed)


def test_losses_of_gtsam_are_left_out_with_a_note():
    huber = gtsam.noiseModel.mEstimator.Huber.Create(1.0)
    noise = gtsam.noiseModel.Diagonal.Sigmas(np.array([0.5, 1, 2]))
    factors = gtsam.NonlinearFactorGraph()
    robust = gtsam.noiseModel.Robust.Create(huber, noise)
    factors.add(gtsam.BetweenFactorPose2(0, 1, gtsam.Pose2(1, 2, 3), robust))
    with pytest.warns(MasatWarning, match="the losses of 1 factors are left out"):
        graph = from_gtsam(factors)
    assert "losses" in graph.notes[0]
    assert_matrices(graph.information, np.diag([4, 1, 0.25])[None], 1e-12)


@DIMENSIONS
def test_random_graphs_survive(d):
    for seed in range(5):
        graph = random_graph(d, 20, 10, seed=seed)
        assert_same(graph, from_gtsam(*to_gtsam(graph)))
