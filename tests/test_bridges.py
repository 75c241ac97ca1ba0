"""Bridges to other packages: round trips without loss, and clear words where there would be one.

Each test is skipped without its package; `make test-bridges` installs all of them.
"""

import re
import subprocess
import sys

import numpy as np
import pytest
from bridge_graphs import (
    DIMENSIONS,
    assert_same,
    graph_of,
    rich,
)

import masat
from masat import GraphError, MasatError, PoseGraph
from masat.bridges.packages import package
from masat.worlds import add_landmarks, sphere


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
