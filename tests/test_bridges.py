"""Bridges to other packages: round trips without loss, and clear words where there would be one.

Each test is skipped without its package; `make test-bridges` installs all of them.
"""

import re
import subprocess
import sys

import numpy as np
import pytest
from random_graphs import random_graph

import masat
from masat import GraphError, MasatError, MasatWarning, PoseGraph, lie
from masat.bridges.packages import package
from masat.worlds import add_landmarks, manhattan, perturb, sphere

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
        for name in ("ids", "positions", "observations", "measurements", "information"):
            assert np.array_equal(getattr(one, name), getattr(two, name)), name
        assert np.array_equal(one.is_range_bearing, two.is_range_bearing)


def assert_poses(one, two, tolerance):
    assert np.abs(lie.local(one, two)).max(initial=0) <= tolerance * max(1, np.abs(one).max())


def assert_matrices(one, two, tolerance):
    scale = np.abs(one).max(axis=(1, 2), keepdims=True)
    assert (np.abs(one - two) <= tolerance * scale).all()


def test_the_package_alone_loads_no_other():
    """`import masat` must not wait for the neighbors."""
    names = ("gtsam", "networkx", "pandas", "open3d", "rerun", "IPython", "masat.bridges")
    code = f"import masat, sys; print([n for n in {names!r} if n in sys.modules])"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[]"


def test_a_missing_package_says_how_to_install_it():
    with pytest.raises(MasatError, match=re.escape('pip install "masat[gtsam]"')):
        package("no_such_package", "gtsam")


# networkx


@DIMENSIONS
@pytest.mark.parametrize("make", [rich, graph_of, lambda d: graph_of(d, poses=None)])
def test_networkx_holds_everything(d, make):
    pytest.importorskip("networkx")
    from masat.bridges.networkx import from_networkx, to_networkx

    graph = make(d)
    assert_same(graph, from_networkx(to_networkx(graph)), tolerance=0)


def test_networkx_finds_paths():
    networkx = pytest.importorskip("networkx")
    from masat.bridges.networkx import to_networkx

    # A ring of six, in which the other way from 0 to 4 is shorter.
    ring = PoseGraph.from_arrays([(k, (k + 1) % 6) for k in range(6)], [(2, 0, 1)] * 6)
    other = to_networkx(ring).to_undirected()
    assert networkx.shortest_path(other, 0, 4, weight="length") == [0, 5, 4]
    assert networkx.shortest_path_length(other, 0, 4, weight="length") == 4


def test_parallel_edges_keep_their_order_in_networkx():
    pytest.importorskip("networkx")
    from masat.bridges.networkx import from_networkx, to_networkx

    edges = [(2, 1), (0, 1), (2, 1), (1, 0), (0, 1)]
    graph = PoseGraph.from_arrays(edges, [(k, 0, 0) for k in range(5)])
    assert_same(graph, from_networkx(to_networkx(graph)), tolerance=0)


def test_a_digraph_made_by_hand_becomes_a_graph():
    networkx = pytest.importorskip("networkx")
    from masat.bridges.networkx import from_networkx

    other = networkx.DiGraph()
    other.add_edge(7, 3, measurement=(1, 2, 0.5))
    graph = from_networkx(other)
    assert graph.edges.tolist() == [[7, 3]]
    assert graph.measurements.tolist() == [[1, 2, 0.5]]
    assert (graph.information == np.eye(3)).all()


@pytest.mark.parametrize(
    ("kind", "add", "message"),
    [
        ("Graph", lambda g: g.add_edge(0, 1, measurement=(1, 0, 0)), "undirected"),
        ("DiGraph", lambda g: g.add_edge("a", 1, measurement=(1, 0, 0)), "node 'a' is no integer"),
        ("DiGraph", lambda g: g.add_edge(4, 1), "edge 4 -> 1 has no attribute 'measurement'"),
        (
            "DiGraph",
            lambda g: (g.add_edge(0, 1, measurement=(1, 0, 0)), g.add_node(0, pose=(0, 0, 0))),
            "node 1 has no attribute 'pose', but others have",
        ),
    ],
)
def test_what_networkx_leaves_open_is_refused(kind, add, message):
    networkx = pytest.importorskip("networkx")
    from masat.bridges.networkx import from_networkx

    other = getattr(networkx, kind)()
    add(other)
    with pytest.raises(GraphError, match=message):
        from_networkx(other)


# pandas


@DIMENSIONS
@pytest.mark.parametrize("make", [rich, graph_of, lambda d: graph_of(d, poses=None)])
def test_pandas_holds_everything(d, make):
    pytest.importorskip("pandas")
    from masat.bridges.pandas import from_pandas, to_pandas

    graph = make(d)
    assert_same(graph, from_pandas(*to_pandas(graph)), tolerance=0)


def test_tables_name_what_they_hold():
    pytest.importorskip("pandas")
    from masat.bridges.pandas import from_pandas, to_pandas

    graph = graph_of(2)
    frames = to_pandas(graph)
    assert frames.nodes.index.tolist() == graph.ids.tolist()
    assert frames.edges["chi2"].sum() == pytest.approx(graph.chi2)
    assert (frames.edges["information_x_theta"] == graph.information[:, 0, 2]).all()
    worst = frames.edges.nlargest(3, "chi2").index
    again = from_pandas(frames.nodes, frames.edges.drop(worst))
    assert np.array_equal(again.edges, graph.without_edges(worst).edges)
    bare = from_pandas(edges=frames.edges[["from", "to", "x", "y", "theta"]])
    assert bare.poses is None
    assert (bare.information == np.eye(3)).all()


def test_a_table_without_a_column_is_refused():
    pytest.importorskip("pandas")
    from masat.bridges.pandas import from_pandas, to_pandas

    frames = to_pandas(graph_of(2))
    with pytest.raises(GraphError, match="the table of edges has no column 'theta'"):
        from_pandas(frames.nodes, frames.edges.drop(columns="theta"))
    with pytest.raises(GraphError, match="give a table of edges"):
        from_pandas(frames.nodes)


# gtsam


@DIMENSIONS
def test_gtsam_holds_poses_edges_and_fixed_nodes(d):
    pytest.importorskip("gtsam")
    from masat.bridges.gtsam import from_gtsam, to_gtsam

    graph = graph_of(d, fixed=[5, 11])
    assert_same(graph, from_gtsam(*to_gtsam(graph)))
    assert_same(
        graph_of(d, fixed=(), poses=None), from_gtsam(*to_gtsam(graph_of(d, fixed=(), poses=None)))
    )


@DIMENSIONS
def test_gtsam_holds_priors(d):
    pytest.importorskip("gtsam")
    from masat.bridges.gtsam import from_gtsam, to_gtsam

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


@DIMENSIONS
def test_small_residuals_cost_the_same_in_gtsam(d):
    """Information has the right order and scale: chi2 agrees to the first order of residuals."""
    pytest.importorskip("gtsam")
    from masat.bridges.gtsam import to_gtsam

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
    gtsam = pytest.importorskip("gtsam")
    from masat.bridges.gtsam import from_gtsam, to_gtsam

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
    gtsam = pytest.importorskip("gtsam")
    from masat.bridges.gtsam import from_gtsam, to_gtsam

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
    gtsam = pytest.importorskip("gtsam")
    from masat.bridges.gtsam import from_gtsam

    graph = graph_of(d, fixed=())
    masat.write(graph, tmp_path / "graph.g2o")
    read = from_gtsam(*gtsam.readG2o(str(tmp_path / "graph.g2o"), d == 3))
    assert np.array_equal(read.edges, graph.edges)
    assert_poses(graph.measurements, read.measurements, 1e-12)
    scale = np.array([1, 1, 1] if d == 2 else [1, 1, 1, 2, 2, 2])
    assert_matrices(graph.information, read.information / np.outer(scale, scale), 1e-9)


def test_gtsams_symbols_are_ids():
    gtsam = pytest.importorskip("gtsam")
    from masat.bridges.gtsam import from_gtsam, to_gtsam

    a, b = gtsam.symbol("a", 3), gtsam.symbol("b", 1)
    graph = PoseGraph.from_arrays([(a, b)], [(1, 0, 0)])
    assert from_gtsam(*to_gtsam(graph)).edges.tolist() == [[a, b]]


@DIMENSIONS
def test_edges_of_rotations_alone_are_held(d):
    pytest.importorskip("gtsam")
    from masat.bridges.gtsam import from_gtsam, to_gtsam

    graph = graph_of(d, fixed=())
    information = graph.information.copy()
    information[7, :d] = information[7, :, :d] = 0
    graph = PoseGraph.from_arrays(graph.edges, graph.measurements, information, ids=graph.ids)
    assert_same(graph, from_gtsam(*to_gtsam(graph)))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda g: g.relabel(lambda ids: ids - 6), "there is a node -1"),
        (lambda g: add_landmarks(g, 3, seed=0), "cannot hold the landmarks"),
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
    pytest.importorskip("gtsam")
    from masat.bridges.gtsam import to_gtsam

    graph = change(graph_of(2))
    with pytest.raises(GraphError, match=message):
        to_gtsam(graph)


def test_what_gtsam_has_no_field_for_is_told():
    pytest.importorskip("gtsam")
    from masat.bridges.gtsam import to_gtsam

    with pytest.warns(MasatWarning, match="no field for the stamps of the nodes"):
        to_gtsam(graph_of(2).with_stamps(np.arange(30.0)))


def test_factors_without_a_counterpart_are_named():
    gtsam = pytest.importorskip("gtsam")
    from masat.bridges.gtsam import from_gtsam

    unit = gtsam.noiseModel.Unit.Create
    factors = gtsam.NonlinearFactorGraph()
    with pytest.raises(GraphError, match="no factor of a pose graph"):
        from_gtsam(factors)
    factors.add(gtsam.BetweenFactorPose2(0, 1, gtsam.Pose2(), unit(3)))
    factors.add(gtsam.RangeFactor2D(0, 9, 1.0, unit(1)))
    with pytest.raises(GraphError, match=r"factor 1, a RangeFactor2D of the keys \[0, 9\]"):
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
    gtsam = pytest.importorskip("gtsam")
    from masat.bridges.gtsam import from_gtsam

    huber = gtsam.noiseModel.mEstimator.Huber.Create(1.0)
    noise = gtsam.noiseModel.Diagonal.Sigmas(np.array([0.5, 1, 2]))
    factors = gtsam.NonlinearFactorGraph()
    robust = gtsam.noiseModel.Robust.Create(huber, noise)
    factors.add(gtsam.BetweenFactorPose2(0, 1, gtsam.Pose2(1, 2, 3), robust))
    with pytest.warns(MasatWarning, match="the losses of 1 factors are left out"):
        graph = from_gtsam(factors)
    assert "losses" in graph.notes[0]
    assert_matrices(graph.information, np.diag([4, 1, 0.25])[None], 1e-12)


# Open3D


def test_open3d_holds_poses_edges_and_certainty():
    pytest.importorskip("open3d")
    from masat.bridges.open3d import CERTAIN, UNCERTAIN, from_open3d, to_open3d

    graph = graph_of(3, fixed=())
    back = from_open3d(to_open3d(graph), ids=graph.ids)
    odometry = np.abs(np.diff(graph.edge_indices, axis=1)).ravel() == 1
    assert back.labels.tolist() == np.where(odometry, CERTAIN, UNCERTAIN).tolist()
    labels = [CERTAIN if k % 3 else UNCERTAIN for k in range(len(graph.edges))]
    graph = PoseGraph.from_arrays(
        graph.edges, graph.measurements, graph.information, poses=graph.poses, labels=labels
    )
    assert_same(graph, from_open3d(to_open3d(graph), ids=graph.ids))


def test_open3d_measures_as_we_do():
    """Exact measurements fit Open3D's poses: its source and target are the right way round."""
    pytest.importorskip("open3d")
    from masat.bridges.open3d import to_open3d

    graph = sphere(30, 60, seed=1)
    other = to_open3d(graph)
    for edge in other.edges:
        source = other.nodes[edge.source_node_id].pose
        target = other.nodes[edge.target_node_id].pose
        assert np.allclose(np.linalg.inv(target) @ source, edge.transformation, atol=1e-12)


def test_open3ds_optimum_is_near_ours():
    open3d = pytest.importorskip("open3d")
    from masat.bridges.open3d import CERTAIN, from_open3d, to_open3d

    graph = graph_of(3, fixed=())
    graph = PoseGraph.from_arrays(
        graph.edges,
        graph.measurements,
        graph.information,
        poses=graph.poses,
        labels=[CERTAIN] * len(graph.edges),
    )
    other = to_open3d(graph)
    registration = open3d.pipelines.registration
    registration.global_optimization(
        other,
        registration.GlobalOptimizationLevenbergMarquardt(),
        registration.GlobalOptimizationConvergenceCriteria(),
        registration.GlobalOptimizationOption(reference_node=0),
    )
    theirs, ours = from_open3d(other, ids=graph.ids), masat.solve(graph).graph
    assert graph.chi2 > 2 * ours.chi2
    assert 0 <= theirs.chi2 / ours.chi2 - 1 < 0.01


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: graph_of(2), "in 3D, and this graph is in 2D"),
        (lambda: graph_of(3, poses=None, fixed=()), "need poses"),
        (lambda: graph_of(3, fixed=[5, 11]), "no fixed nodes"),
        (
            lambda: graph_of(3).with_priors(masat.gps([5], [(0, 0, 0)], 1)),
            "cannot hold the priors",
        ),
    ],
)
def test_what_open3d_cannot_hold_is_refused(make, message):
    pytest.importorskip("open3d")
    from masat.bridges.open3d import to_open3d

    with pytest.raises(GraphError, match=message):
        to_open3d(make())


def test_a_random_graph_survives_all_bridges():
    for name in ("networkx", "gtsam"):
        pytest.importorskip(name)
    from masat.bridges.gtsam import from_gtsam, to_gtsam
    from masat.bridges.networkx import from_networkx, to_networkx

    for seed in range(5):
        graph = random_graph(3, 20, 10, seed=seed)
        assert_same(graph, from_gtsam(*to_gtsam(graph)))
        assert_same(graph, from_networkx(to_networkx(graph)), tolerance=0)


# rerun


def recorded(path):
    """The columns of the recording's entities, by entity and then by name, without nesting."""
    from rerun.chunk import RrdReader

    found = {}
    for chunk in RrdReader(str(path)).stream().to_chunks():
        columns = chunk.to_record_batch().to_pydict()
        entity = found.setdefault(chunk.entity_path, {})
        for name, values in columns.items():
            entity.setdefault(name.split(":")[-1], []).extend(values)
    return found


@DIMENSIONS
def test_rerun_gets_all_layers_at_each_step(d, tmp_path):
    pytest.importorskip("rerun")
    from masat.bridges.rerun import save_rerun

    graph = graph_of(d, fixed=())
    graph = graph.with_priors(masat.gps(graph.ids[:3], graph.poses[:3, :d], 0.5))
    graph = add_landmarks(graph, 4, seed=0)
    steps = []
    result = masat.solve(graph, init="odometry", report_poses=steps.append)
    path = tmp_path / "map.rrd"
    size = save_rerun(result, path, before=graph, iterations=steps, truth=graph, title="A map")
    assert size == path.stat().st_size
    found = recorded(path)
    frames = len(steps) + 1
    layers = ("nodes", "odometry", "closures", "priors", "landmarks", "observations", "truth")
    for name in layers:
        entity = found[f"/map/{name}"]
        assert len(entity["map"]) == (frames if layers.index(name) < 3 else 1)
    assert found["/chi2_of_edges"]["scalars"][-1] == [
        pytest.approx(result.graph.chi2_per_edge.sum())
    ]
    assert found["/about"]["text"][0][0].startswith("A map\ngraph: ")
    # The result is drawn at the poses of the result, but for the center of the map.
    positions = np.array(found["/map/nodes"]["positions"][-1])
    true = np.zeros((len(graph), 3))
    true[:, :d] = result.poses[:, :d]
    assert np.allclose(np.diff(positions, axis=0), np.diff(true, axis=0), atol=1e-5)
    strips = found["/map/odometry"]["strips"][-1]
    assert len(strips) == len(graph) - 1


def test_masat_view_writes_a_recording(tmp_path, run):
    pytest.importorskip("rerun")
    masat.write(graph_of(2, fixed=()), tmp_path / "graph.g2o")
    code, out, _ = run("view", "graph.g2o", "--rerun", "--solve")
    assert code == 0
    assert "graph.rrd" in out
    assert "/map/closures" in recorded(tmp_path / "graph.rrd")
    code, _, err = run("view", "graph.g2o", "--rerun", "--covariances")
    assert code == 2
    assert "leave out --covariances" in err


def test_without_rerun_the_command_says_what_to_install(tmp_path, run, monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", None)
    masat.write(graph_of(2, fixed=()), tmp_path / "graph.g2o")
    code, _, err = run("view", "graph.g2o", "--rerun")
    assert code == 2
    assert 'pip install "masat[rerun]"' in err
