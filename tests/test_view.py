"""The view: what it draws, how that is packed, and the page around it."""

import re
from importlib.resources import files

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

import masat
from masat import lie
from masat.cli import cli
from masat.cli.view import view as command
from masat.residuals import residuals
from masat.viewing.page import MODULES
from masat.viewing.payload import pack, unpack
from masat.viewing.states import _chosen
from masat.worlds import add_false_closures, manhattan, perturb, sphere

SCRIPTS = files("masat.viewing") / "js"


@pytest.fixture(scope="module")
def graph():
    return perturb(manhattan(60, 100, extent=6, seed=1), (0.05, 0.05, 0.02), seed=1)


@pytest.fixture(scope="module")
def spoiled():
    """A graph with false loop closures, without a map, and its robust result."""
    world = perturb(manhattan(300, 500, extent=10, seed=2), (0.05, 0.05, 0.02), seed=2)
    mapped = masat.solve(world).graph
    graph, _ = add_false_closures(mapped, "random", 0.1, seed=3)
    result = masat.solve(graph, robust=True)
    assert not result.kept.all()
    return graph, result


def content(view):
    """The header and the arrays of a page."""
    payload = re.search(r'<script id="payload" type="text/plain">(.*?)</script>', view.html)
    return unpack(payload[1])


@given(
    arrays.arrays(
        st.sampled_from(["f4", "f8", "i4", "i8", "u1", "u2", "?"]),
        arrays.array_shapes(min_dims=1, max_dims=3, min_side=0),
    ),
    st.text(),
)
def test_a_payload_round_trips(array, text):
    header, unpacked = unpack(pack({"title": text}, {"first": np.zeros(3, np.uint8), "a": array}))
    assert header == {"title": text}
    expected = array.astype(np.uint8) if array.dtype == bool else array
    np.testing.assert_array_equal(unpacked["a"], expected)
    assert unpacked["a"].dtype == expected.dtype


def test_a_graph_is_drawn_as_it_is(graph):
    header, drawn = content(masat.view(graph, title="a <b> & c"))
    assert header["title"] == "a <b> & c"
    assert header["states"] == ["map"]
    np.testing.assert_array_equal(drawn["ids"], graph.ids)
    np.testing.assert_array_equal(graph.ids[drawn["ends"]], graph.edges)
    np.testing.assert_array_equal(drawn["kept"], 1)
    np.testing.assert_allclose(drawn["chi2"][0], graph.chi2_per_edge, rtol=1e-6)
    np.testing.assert_allclose(drawn["residuals"], residuals(graph), rtol=1e-6, atol=1e-12)
    positions = drawn["positions"][0] + header["center"]
    np.testing.assert_allclose(positions, graph.poses[:, :2], atol=1e-6)
    assert header["chi2"] == [pytest.approx(graph.chi2)]


def test_positions_far_from_the_origin_keep_their_digits(graph):
    moved = graph.with_poses(graph.poses + np.array([5e5, 5e6, 0]))
    header, drawn = content(masat.view(moved))
    positions = drawn["positions"][0] + header["center"]
    np.testing.assert_allclose(positions, moved.poses[:, :2], atol=1e-5, rtol=0)


def test_the_slider_goes_through_all_iterations(graph):
    steps = []
    result = masat.solve(graph, init="odometry", report_poses=steps.append)
    assert len(steps) == result.iterations + 1
    costs = [graph.with_poses(poses).chi2 for poses in steps]
    assert costs[0] == pytest.approx(result.initial_chi2)
    np.testing.assert_allclose(costs[1:], [step.chi2 for step in result.history], rtol=1e-9)
    header, drawn = content(masat.view(result, before=graph, iterations=steps))
    last = result.iterations
    assert header["states"] == [
        "before",
        "initial guess",
        *(f"iteration {k} of {last}" for k in range(1, last)),
        "result",
    ]
    np.testing.assert_allclose(header["chi2"], [graph.chi2, *costs], rtol=1e-6)
    np.testing.assert_allclose(drawn["chi2"].sum(axis=1), header["chi2"], rtol=1e-5)
    for poses, positions in zip(steps, drawn["positions"][1:], strict=True):
        np.testing.assert_allclose(positions + header["center"], poses[:, :2], atol=1e-5)


@pytest.mark.parametrize("optimizer", ["lm", "gn", "dogleg"])
@pytest.mark.parametrize("loss", [None, "cauchy"])
def test_poses_are_reported_after_each_iteration(graph, optimizer, loss):
    steps = []
    guess = masat.initialize(graph, "odometry")
    result = masat.optimize(guess, optimizer, loss=loss, report_poses=steps.append)
    assert len(steps) == result.iterations + 1
    np.testing.assert_array_equal(steps[0], guess.poses)
    chi2 = [graph.with_poses(poses).chi2 for poses in steps]
    if loss is None:
        np.testing.assert_allclose(chi2[1:], [step.chi2 for step in result.history], rtol=1e-9)
    np.testing.assert_allclose(steps[-1], result.poses, atol=1e-6)


def test_poses_of_a_graph_with_priors_are_reported_in_its_order(graph):
    fixes = masat.gps(graph.ids[::20], graph.poses[::20, :2], sigma=1.0)
    steps = []
    result = masat.solve(graph.with_priors(fixes), init="odometry", report_poses=steps.append)
    assert all(poses.shape == graph.poses.shape for poses in steps)
    np.testing.assert_allclose(steps[-1], result.poses, atol=1e-6)


def test_iterations_that_are_too_many_are_thinned():
    for count in range(1, 80):
        for limit in range(2, 20):
            kept = _chosen(count, limit)
            assert len(kept) == min(count, limit)
            assert kept[0] == 0
            assert kept[-1] == count - 1
            assert (np.diff(kept) > 0).all()


def test_a_map_before_is_moved_onto_the_result(graph):
    result = masat.solve(graph)
    turned = lie.compose([30.0, -4.0, 2.0], result.poses)
    before = graph.with_poses(turned)
    header, drawn = content(masat.view(result, before={"turned": before}))
    assert header["states"] == ["turned", "result"]
    np.testing.assert_allclose(drawn["positions"][0], drawn["positions"][1], atol=1e-5)


def test_the_odometry_is_drawn_where_the_graph_has_no_poses(graph):
    bare = masat.PoseGraph.from_arrays(graph.edges, graph.measurements, graph.information)
    header, _ = content(masat.view(masat.solve(bare), before=bare))
    assert header["states"] == ["odometry", "result"]


def test_rejected_edges_are_drawn_with_what_they_measured_and_why(spoiled):
    graph, result = spoiled
    header, drawn = content(masat.view(result, before=graph))
    np.testing.assert_array_equal(drawn["kept"], result.kept)
    np.testing.assert_array_equal(graph.ids[drawn["ends"]], graph.edges)
    np.testing.assert_allclose(drawn["measurements"], graph.measurements, rtol=1e-6)
    chi2 = graph.with_poses(result.poses).chi2_per_edge
    np.testing.assert_allclose(drawn["chi2"][-1], chi2, rtol=1e-6)
    assert header["chi2"][-1] == pytest.approx(result.chi2)
    for row in result.closures:
        assert header["reasons"][drawn["reason"][row["edge"]]] == row["reason"]
        np.testing.assert_allclose(drawn["distance"][row["edge"]], row["distance"], rtol=1e-6)
    assert header["reasons"][drawn["reason"][0]] == "trusted"


def test_without_the_graph_rejected_edges_are_drawn_too(spoiled):
    graph, result = spoiled
    _, drawn = content(masat.view(result))
    np.testing.assert_array_equal(drawn["kept"], result.kept)
    np.testing.assert_array_equal(graph.ids[drawn["ends"]], graph.edges)
    np.testing.assert_array_equal(np.isnan(drawn["chi2"][-1]), ~result.kept)
    np.testing.assert_array_equal(np.isnan(drawn["measurements"]).all(axis=1), ~result.kept)


def test_weights_labels_sessions_and_stamps_are_drawn(graph):
    labeled = masat.PoseGraph.from_arrays(
        graph.edges,
        graph.measurements,
        graph.information,
        poses=graph.poses,
        labels=np.where(np.arange(len(graph.edges)) % 2, "lidar", "camera"),
        stamps=10**18 + np.arange(len(graph)) * 10**8,
    )
    result = masat.optimize(labeled, loss="cauchy")
    header, drawn = content(masat.view(result))
    np.testing.assert_allclose(drawn["weights"], result.weights, rtol=1e-6)
    assert [header["labels"][k] for k in drawn["label"][:2]] == ["camera", "lidar"]
    np.testing.assert_allclose(drawn["stamps"], np.arange(len(graph)) * 0.1)
    assert header["first_stamp"] == str(10**18)
    merged = masat.merge([graph, graph], between=([(0, 3, 1, 3)], [(0, 0, 0)]))
    _, drawn = content(masat.view(merged))
    np.testing.assert_array_equal(drawn["session"], masat.sessions(merged))


def test_priors_and_landmarks_are_drawn(graph):
    fixes = masat.gps([5, 9], [(1, 2), (3, 4)], sigma=2.0)
    compass = masat.headings([7], [0.5], sigma=0.1)
    seen = masat.landmarks(
        [(3, 1000), (4, 1000)], [(1.0, 0.0), (0.0, 1.0)], positions=[(7.0, 8.0)], ids=[1000]
    )
    more = graph.with_priors([fixes, compass]).with_landmarks(seen)
    header, drawn = content(masat.view(more))
    np.testing.assert_array_equal(graph.ids[drawn["prior_nodes"]], [5, 9, 7])
    expected = [(1, 2), (3, 4), (np.nan, np.nan)]
    np.testing.assert_allclose(drawn["fixes"] + header["center"], expected, atol=1e-5)
    np.testing.assert_allclose(drawn["prior_chi2"], more.chi2_per_prior, rtol=1e-6)
    np.testing.assert_allclose(drawn["landmarks"] + header["center"], [(7, 8)], atol=1e-5)
    np.testing.assert_allclose(drawn["observation_chi2"], more.chi2_per_observation, rtol=1e-6)
    np.testing.assert_array_equal(drawn["observations"], [(3, 0), (4, 0)])


def test_an_antenna_is_drawn_where_the_node_would_be():
    # The node looks along y, and its antenna is a meter ahead, at (0, 1).
    graph = masat.PoseGraph.from_arrays(
        [(0, 1)], [(1, 0, 0)], poses=[(0, 0, np.pi / 2), (0, 1, np.pi / 2)]
    ).with_priors(masat.gps([0], [(0.5, 1.0)], sigma=1.0, lever_arm=(1.0, 0.0)))
    header, drawn = content(masat.view(graph))
    np.testing.assert_allclose(drawn["fixes"] + header["center"], [(0.5, 0)], atol=1e-6)


def test_the_truth_is_moved_onto_the_map(graph):
    truth = graph.with_poses(lie.compose([100.0, 7.0, -1.0], graph.poses)).without_nodes([4])
    header, drawn = content(masat.view(graph, truth=truth))
    known = np.arange(len(graph)) != 4
    np.testing.assert_allclose(drawn["truth"][known], drawn["positions"][0][known], atol=1e-5)
    assert np.isnan(drawn["truth"][4]).all()
    assert header["truth_rmse"] == pytest.approx(0, abs=1e-9)


def test_covariances_are_along_the_axes_of_the_world():
    # One step along y, measured with 1 m ahead and 0.1 m sideways, after a node that is not moved.
    graph = masat.PoseGraph.from_arrays(
        [(0, 1)],
        [(1, 0, 0)],
        np.diag([1.0, 100.0, 400.0]),
        poses=[(0, 0, np.pi / 2), (0, 1, np.pi / 2)],
    )
    _, drawn = content(masat.view(graph, covariances=True))
    # Upper triangles: xx, xy, yy.
    np.testing.assert_allclose(drawn["covariances"][0], 0, atol=1e-9)
    np.testing.assert_allclose(drawn["covariances"][1], [0.01, 0, 1], atol=1e-6)


def test_maps_that_diverged_are_drawn(graph):
    far = graph.poses.copy()
    far[5:, 0] = 1e60
    header, drawn = content(masat.view(graph, iterations=[far, graph.poses]))
    assert header["chi2"][0] > 1e100
    assert np.isinf(drawn["chi2"][0]).any()
    assert np.isfinite(drawn["chi2"][1]).all()


def test_a_3d_map_is_drawn():
    graph = perturb(sphere(100, seed=0), (0.1, 0.1, 0.1, 0.05, 0.05, 0.05), seed=0)
    header, drawn = content(masat.view(masat.solve(graph), before=graph, covariances=True))
    assert header["dimension"] == 3
    assert drawn["positions"].shape == (2, len(graph), 3)
    assert drawn["rotations"].shape == (len(graph), 4)
    assert drawn["covariances"].shape == (len(graph), 6)
    assert drawn["residuals"].shape == (len(graph.edges), 6)


def test_what_cannot_be_drawn_is_refused(graph, spoiled):
    bare = masat.PoseGraph.from_arrays(graph.edges, graph.measurements)
    with pytest.raises(masat.GraphError, match="no poses to draw"):
        masat.view(bare)
    with pytest.raises(masat.GraphError, match="'before' has other nodes"):
        masat.view(graph, before=graph.without_nodes([3]))
    with pytest.raises(masat.GraphError, match="iteration 1 have shape"):
        masat.view(graph, iterations=[graph.poses, graph.poses[1:]])
    with pytest.raises(masat.GraphError, match="give the graph that was solved"):
        masat.view(spoiled[1], before=spoiled[0].without_edges([0]))


def test_a_view_shows_itself_and_is_written(graph, tmp_path):
    path = tmp_path / "map.html"
    view = masat.view(graph, path)
    assert path.read_text() == view.html
    assert view._repr_html_().startswith('<iframe srcdoc="&lt;!doctype html')
    assert "MB" in repr(view)


def test_the_page_is_self_contained(graph):
    html = masat.view(graph, title="</script><b>").html
    # The namespaces of XHTML and SVG are names, which nothing fetches.
    addresses = set(re.findall(r"""(?:https?:)?//[\w.-]+\.[a-z]{2,}[^\s"'`)]*""", html))
    assert {a for a in addresses if "www.w3.org/" not in a} == set()
    assert re.findall(r"<(?:link|script|img)[^>]* (?:src|href)=[^>]*>", html) == [
        '<link rel="icon" href="data:,">'
    ]
    assert "default-src 'none'" in html
    # Whatever the title is, it ends no element: three scripts are opened and closed.
    assert len(re.findall(r"<script\b", html)) == len(re.findall(r"</script>", html)) == 3
    assert "MIT License" in html


def test_modules_import_what_modules_above_them_export():
    names = [path.name for path in SCRIPTS.iterdir()]
    assert sorted(names) == sorted(f"{name}.js" for name in MODULES)
    exported = {}
    declared = []
    for name in MODULES:
        text = (SCRIPTS / f"{name}.js").read_text()
        imports = re.findall(r'^import \{ (.*?) \} from "\./(\w+)\.js";', text, re.M | re.S)
        assert len(imports) == len(re.findall(r"^import\b", text, re.M)), name
        for wanted, module in imports:
            assert set(wanted.split(", ")) <= exported[module], f"{name} imports {wanted}"
        pattern = r"^export (?:async )?(?:function|class|const) (\w+)"
        exported[name] = set(re.findall(pattern, text, re.M))
        pattern = r"^(?:export )?(?:async )?(?:function|class) (\w+)"
        declared += re.findall(pattern, text, re.M)
        for line in re.findall(r"^(?:export )?const (.*)", text, re.M):
            declared += re.findall(r"(?:^|, )(\w+) = ", line)
    # They share one scope in the page.
    assert len(declared) == len(set(declared)), sorted(declared)


@pytest.mark.parametrize(
    ("text", "edges"),
    [
        ("3\n", [3]),
        ("# a comment\n\n5 6  # odometry\n", [5]),
        ("5 6 5\n2\n2\n", [2, 5]),
        ("0 9\n", [60, 61]),
        ("0 9 61", [61]),
    ],
)
def test_an_edge_list_names_edges(tmp_path, text, edges):
    chain = [(k, k + 1) for k in range(60)]
    graph = masat.PoseGraph.from_arrays([*chain, (0, 9), (0, 9)], [(1, 0, 0)] * 62)
    path = tmp_path / "list.txt"
    path.write_text(text)
    assert masat.formats.read_edge_list(path, graph).tolist() == edges


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("1\n2\n60\n", r"list\.txt:3: there is no edge 60: the graph has 60 edges"),
        ("-1\n", r"list\.txt:1: there is no edge -1"),
        ("5 7\n", r"list\.txt:1: the graph has no edge from 5 to 7$"),
        ("6 5\n", r"list\.txt:1: the graph has no edge from 6 to 5; there is one from 5 to 6"),
        ("5 6 7\n", r"edge 7 does not lead from 5 to 6: the list belongs to another file"),
        ("5 6 7 8\n", r"'5 6 7 8' names no edge"),
        ("5 six\n", r"'5 six' names no edge: expected its index"),
        ("5.0\n", r"'5\.0' names no edge"),
        ("# nothing\n", r"list\.txt: the file names no edge"),
        ("", r"list\.txt: the file names no edge"),
    ],
)
def test_a_bad_edge_list_is_refused(tmp_path, text, said):
    chain = [(k, k + 1) for k in range(60)]
    graph = masat.PoseGraph.from_arrays(chain, [(1, 0, 0)] * 60)
    path = tmp_path / "list.txt"
    path.write_text(text)
    with pytest.raises(masat.FormatError, match=said):
        masat.formats.read_edge_list(path, graph)


def run(*words):
    return CliRunner().invoke(cli, [str(word) for word in words], catch_exceptions=False)


def test_solve_leaves_out_the_edges_of_a_list(graph, tmp_path):
    source, out, listed = tmp_path / "graph.g2o", tmp_path / "map.g2o", tmp_path / "off.txt"
    masat.write(graph, source)
    listed.write_text("# from to index\n" + f"{graph.edges[70, 0]} {graph.edges[70, 1]} 70\n75\n")
    done = run("solve", source, "--without", listed, "-o", out)
    assert done.exit_code == 0
    assert "2 of 100 edges are left out" in done.stderr
    expected = masat.solve(masat.read(source).without_edges([70, 75]), certify=True)
    np.testing.assert_allclose(masat.read(out).poses, expected.poses, rtol=1e-12, atol=1e-12)
    assert len(masat.read(out).edges) == 98
    with pytest.raises(masat.FormatError, match="names no edge"):
        run("solve", source, "--without", source)
    with pytest.raises(masat.MasatError, match="is the input"):
        run("solve", source, "--without", listed, "-o", listed)


def test_the_command_writes_a_page(graph, spoiled, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    masat.write(graph, "walk.g2o")
    done = run("view", "walk.g2o")
    assert done.exit_code == 0
    assert done.stdout.startswith("walk.html")
    header, _ = unpack(re.search(r'text/plain">(.*?)</', (tmp_path / "walk.html").read_text())[1])
    assert header["states"] == ["map"]
    assert header["title"] == "walk.g2o"
    run("view", "walk.g2o", "--solve", "--init", "odometry", "-o", "solved.html", "-q")
    header, _ = unpack(re.search(r'text/plain">(.*?)</', (tmp_path / "solved.html").read_text())[1])
    assert header["states"][:2] == ["poses of walk.g2o", "initial guess"]
    assert header["states"][2].startswith("iteration 1 of ")
    solved, result = spoiled
    masat.write(solved, "spoiled.g2o")
    result.save("result.npz")
    run("view", "spoiled.g2o", "result.npz", "-q", "--truth", "spoiled.g2o")
    text = (tmp_path / "result.html").read_text()
    header, drawn = unpack(re.search(r'text/plain">(.*?)</', text)[1])
    assert header["states"] == ["spoiled.g2o", "result"]
    np.testing.assert_array_equal(drawn["kept"], result.kept)
    assert not np.isnan(drawn["measurements"]).any()
    with pytest.raises(masat.MasatError, match="is the input"):
        run("view", "walk.g2o", "-o", "walk.g2o")


def test_a_graph_without_poses_is_solved(graph, tmp_path):
    masat.write(graph, tmp_path / "walk.g2o")
    lines = (tmp_path / "walk.g2o").read_text().splitlines()
    edges = [line for line in lines if line.startswith("EDGE")]
    (tmp_path / "bare.g2o").write_text("\n".join(edges))
    done = run("view", tmp_path / "bare.g2o", "-o", tmp_path / "map.html")
    assert "has no poses, so the graph is solved" in done.stderr
    assert done.exit_code == 0


def test_the_help_teaches():
    text = run("view", "--help").stdout
    for word in ("--solve", "--robust", "--truth", "--covariances", "masat solve --without"):
        assert word in text
    assert command.help
