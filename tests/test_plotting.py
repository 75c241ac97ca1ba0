import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgb
from random_graphs import random_graph

import masat
from masat import GraphError, MasatError, PoseGraph, lie
from masat.optimizers import Result
from masat.plotting import before_and_after
from masat.plotting import panel as panel_module
from masat.plotting.panel import CLOSURES, REJECTED, TRAJECTORY, occupied, stroke
from masat.worlds import add_false_closures, grid, manhattan, perturb

PNG = b"\x89PNG"


def lines(ax):
    return [c for c in ax.collections if isinstance(c, LineCollection)]


def legend(figure):
    (box,) = figure.legends
    return [text.get_text() for text in box.get_texts()]


def spatial(extents, count=50, seed=0):
    """A 3D chain with random positions in a box."""
    random = np.random.default_rng(seed)
    poses = np.tile(lie.identity(3), (count, 1))
    poses[:, :3] = random.uniform(0, 1, (count, 3)) * extents
    poses[:2, :3] = [np.zeros(3), extents]
    edges = np.column_stack([np.arange(count - 1), np.arange(1, count)])
    return PoseGraph.from_arrays(edges, lie.between(poses[:-1], poses[1:]), poses=poses)


def test_trajectory_and_loop_closures_are_drawn_where_the_poses_are():
    graph = manhattan(200, 300, extent=8)
    figure = masat.plot(graph)
    chain, loops = lines(figure.axes[0])
    assert len(chain.get_segments()) == 199
    assert len(loops.get_segments()) == 101
    assert np.array_equal(chain.get_segments()[0], graph.poses[:2, :2])
    (left, right), (bottom, top) = figure.axes[0].get_xlim(), figure.axes[0].get_ylim()
    assert left < graph.poses[:, 0].min()
    assert right > graph.poses[:, 0].max()
    assert np.isclose(right - left, top - bottom)


@pytest.mark.parametrize("dimension", [2, 3])
def test_loop_closures_lie_above_the_trajectory_and_are_thinner(dimension):
    figure = masat.plot(random_graph(dimension, 300, 200, seed=1), view="oblique")
    chain, loops = figure.axes[0].collections
    assert loops.get_zorder() > chain.get_zorder()
    assert loops.get_linewidth()[0] < chain.get_linewidth()[0]
    assert getattr(figure.axes[0], "computed_zorder", False) is False


# Machado, Oliveira, Fernandes, A physiologically-based model for simulation of color vision
# deficiency, 2009, severity 1: matrices on linear RGB.
BLINDNESS = {
    "none": np.eye(3),
    "red": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216],
            [-0.003882, -0.048116, 1.051998]],
    "green": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413],
              [-0.011820, 0.042940, 0.968881]],
    "blue": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602],
             [0.004733, 0.691367, 0.303900]],
}  # fmt: skip


@pytest.mark.parametrize("kind", BLINDNESS)
def test_color_blind_people_tell_loop_closures_from_the_trajectory(kind):
    def luminance(color):
        rgb = np.array(to_rgb(color))
        linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
        return np.array([0.2126, 0.7152, 0.0722]) @ np.clip(BLINDNESS[kind] @ linear, 0, 1)

    # The contrast ratio of WCAG 2; 1 is none.
    assert (luminance(CLOSURES) + 0.05) / (luminance(TRAJECTORY) + 0.05) > 2
    assert (luminance(REJECTED) + 0.05) / (luminance(TRAJECTORY) + 0.05) > 2


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("suffix", ["png", "pdf", "svg"])
def test_a_picture_is_written_in_the_format_of_its_name(dimension, suffix, tmp_path):
    path = tmp_path / f"map.{suffix}"
    masat.plot(random_graph(dimension, 10, 10, seed=1), path)
    begin = {"png": PNG, "pdf": b"%PDF", "svg": b"<?xml"}[suffix]
    assert path.read_bytes().startswith(begin)


def test_an_unknown_format_is_refused_and_nothing_is_written(tmp_path):
    with pytest.raises(MasatError, match=r"no picture can be written as .xyz; known: .*png"):
        masat.plot(manhattan(100, 150, extent=6), tmp_path / "map.xyz")
    assert list(tmp_path.iterdir()) == []


def test_jupyter_shows_the_figure():
    formatters = pytest.importorskip("IPython.core.formatters")
    figure = masat.plot(manhattan(100, 150, extent=6))
    assert formatters.PNGFormatter()(figure).startswith(PNG)


def test_the_figure_shows_itself_in_the_pixels_that_were_asked_for():
    data = masat.plot(manhattan(100, 150, extent=6), dpi=50)._repr_png_()
    # Width and height follow the signature and the header of the first chunk.
    assert np.frombuffer(data[16:24], ">u4").tolist() == [400, 400]


def test_the_package_starts_without_matplotlib():
    loaded = "import sys, masat; print('matplotlib' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", loaded], capture_output=True, text=True)
    assert done.stdout.split() == ["False"], done.stderr


@pytest.mark.parametrize("dimension", [2, 3])
def test_before_and_after_have_a_panel_each_and_share_the_colors(dimension):
    one, two = (random_graph(dimension, 10, 10, seed=s) for s in (1, 2))
    figure = masat.plot({"before": one, "after": two}, color_by_error=True)
    before, after, scale = figure.axes
    assert (before.get_title(), after.get_title()) == ("before", "after")
    assert scale.get_ylabel() == "chi2 of the edge"
    limits = {c.get_clim() for ax in (before, after) for c in ax.collections}
    assert len(limits) == 1


def test_edges_of_large_chi2_are_drawn_last():
    graph = PoseGraph.from_arrays(
        [(0, 1), (1, 2), (2, 3)], [(1, 0, 0), (3, 0, 0), (2, 0, 0)], poses=np.zeros((4, 3))
    )
    (drawn,) = lines(masat.plot(graph, color_by_error=True).axes[0])
    assert drawn.get_array().tolist() == [1, 4, 9]


def test_an_exact_fit_can_be_colored():
    masat.plot(manhattan(100, 150, extent=6), color_by_error=True)


def test_a_panel_tells_its_size_and_chi2():
    graph = PoseGraph.from_arrays(
        [(0, 1), (1, 2), (2, 0)], [(1, 0, 0), (1, 0, 0), (0, 0, 0)],
        poses=[(0, 0, 0), (1, 0, 0), (2, 0, 0)],
    )  # fmt: skip
    (caption,) = masat.plot(graph).axes[0].texts
    assert caption.get_text() == "3 nodes, 3 edges (1 loop closure), chi2 4"


def test_the_legend_names_what_is_drawn():
    graph = manhattan(100, 150, extent=6)
    assert legend(masat.plot(graph)) == ["odometry", "loop closures", "first node"]
    one = PoseGraph.from_arrays([(0, 1)], [(1, 0, 0)], poses=np.eye(3)[:2], fixed=[1])
    assert legend(masat.plot(one)) == ["odometry", "fixed node", "first node"]
    assert legend(masat.plot({"a": graph, "b": one})) == [
        "odometry", "loop closures", "first node", "fixed node",
    ]  # fmt: skip


def test_the_legend_tells_that_not_all_loop_closures_are_drawn(monkeypatch):
    monkeypatch.setattr(panel_module, "_MOST_CLOSURES", 25)
    large, small = manhattan(100, 150, extent=6), manhattan(100, 110, extent=6)
    figure = masat.plot(large)
    assert "loop closures (1 in 3 drawn)" in legend(figure)
    assert [len(drawn.get_segments()) for drawn in lines(figure.axes[0])] == [99, 17]
    # Each panel tells its own number.
    figure = masat.plot({"large": large, "small": small})
    assert "loop closures (not all drawn)" in legend(figure)
    assert ["1 in 3 drawn" in ax.texts[0].get_text() for ax in figure.axes] == [True, False]
    assert [len(lines(ax)[1].get_segments()) for ax in figure.axes] == [17, 11]
    # Colored by chi2 the edges that fit worst are looked for: all are drawn.
    (every,) = lines(masat.plot(large, color_by_error=True).axes[0])
    assert len(every.get_segments()) == 150


def test_long_loop_closures_that_would_hide_all_else_are_thinned_out():
    random = np.random.default_rng(0)
    poses = np.column_stack([random.uniform(0, 100, (400, 2)), np.zeros(400)])
    chain = np.column_stack([np.arange(399), np.arange(1, 400)])
    loops = random.integers(400, size=(40000, 2))
    edges = np.concatenate([chain, loops[np.abs(loops[:, 0] - loops[:, 1]) > 1]])
    graph = PoseGraph.from_arrays(edges, np.zeros((len(edges), 3)), poses=poses)
    figure = masat.plot(graph)
    odometry, closures = (len(drawn.get_segments()) for drawn in lines(figure.axes[0]))
    assert odometry == 399
    # Random chords of a square are .52 sides long on average. 40,000 of them, at .15 points and an
    # alpha of .1, cover 312 points times the side: twice .28 of a side of 576 points.
    assert closures == -(-(len(edges) - 399) // 2)
    assert "loop closures (1 in 2 drawn)" in legend(figure)


def test_the_legend_is_not_as_faint_as_the_lines():
    graph = random_graph(2, 300, 20000, seed=1)
    (box,) = masat.plot(graph).legends
    assert {line.get_alpha() for line in box.get_lines()} == {1.0}


def test_a_title_is_no_formula():
    figure = masat.plot({"a $ b $ \\frac": manhattan(100, 150, extent=6)})
    figure._repr_png_()
    assert figure.axes[0].get_title() == "a $ b $ \\frac"


def test_lines_cover_the_area_asked_for():
    # 10 panels long, 1 point wide: 10 panel points.
    assert stroke(10, 10, widest=2) == (1, 1, 1)
    assert stroke(10, 100, widest=2) == (2, 1, 1)
    assert stroke(1000, 30, widest=2) == (0.15, pytest.approx(0.2), 1)
    # Half of the faintest lines cover it.
    assert stroke(1000, 7.5, widest=2) == (0.15, 0.1, 2)


def test_the_cells_that_lines_run_through_are_counted():
    # A horizontal line across the panel meets one of 64 rows, but only at the nine samples.
    across = np.array([[(0.0, 0.0), (64.0, 0.0)]])
    assert occupied(across, 64.0) == 9 / 64**2
    steps = np.array([[(k, 0.0), (k + 1, 0.0)] for k in np.arange(63.0)])
    assert occupied(steps, 64.0) == 64 / 64**2


def test_many_lines_are_thin_and_stored_as_pixels(tmp_path):
    few, many = manhattan(100, 150, extent=6), manhattan(10000, 20050, extent=25)
    thick, thin = (lines(masat.plot(g).axes[0])[0] for g in (few, many))
    assert thin.get_linewidth()[0] < thick.get_linewidth()[0]
    masat.plot(few, tmp_path / "few.svg")
    masat.plot(many, tmp_path / "many.svg", dpi=60)
    assert b"<image" not in (tmp_path / "few.svg").read_bytes()
    assert b"<image" in (tmp_path / "many.svg").read_bytes()
    assert (tmp_path / "many.svg").stat().st_size < 1e6


@pytest.mark.parametrize(
    ("extents", "view", "labels"),
    [
        ((10, 10, 10), "auto", ("x [m]", "y [m]", "z [m]")),
        ((10, 10, 1), "auto", ("x [m]", "y [m]")),
        ((10, 0.5, 8), "auto", ("x [m]", "z [m]")),
        ((10, 0, 0), "auto", ("x [m]", "y [m]")),
        ((10, 10, 1), "oblique", ("x [m]", "y [m]", "z [m]")),
        ((10, 10, 10), "top", ("x [m]", "y [m]")),
    ],
)
def test_the_view_of_3d_graphs(extents, view, labels):
    graph = spatial(np.array(extents, float))
    ax = masat.plot(graph, view=view).axes[0]
    named = [getattr(ax, f"get_{name}label")() for name in "xyz"[: len(labels)]]
    assert tuple(named) == labels
    assert (ax.name == "3d") == (len(labels) == 3)
    if len(labels) == 2:
        kept = ["xyz".index(label[0]) for label in labels]
        drawn = lines(ax)[0].get_segments()[0]
        assert np.array_equal(drawn, graph.poses[:2][:, kept])


def test_panels_of_3d_graphs_share_the_view():
    flat, deep = spatial(np.array([10.0, 10, 1])), spatial(np.array([10.0, 10, 10]))
    figure = masat.plot({"flat": flat, "deep": deep})
    assert [ax.name for ax in figure.axes] == ["3d", "3d"]


def test_a_meter_is_as_long_on_each_axis_of_an_oblique_view():
    ax = masat.plot(spatial(np.array([10.0, 4, 3]))).axes[0]
    spans = [np.ptp(limits) for limits in (ax.get_xlim(), ax.get_ylim(), ax.get_zlim())]
    meters_per_length = np.array(spans) / ax._box_aspect
    assert np.allclose(meters_per_length, meters_per_length[0])


def test_panels_have_the_same_scale_only_if_asked():
    panels = {"small": manhattan(100, 150, extent=6), "large": manhattan(400, 600, extent=20)}

    def widths(**options):
        return [np.ptp(ax.get_xlim()) for ax in masat.plot(panels, **options).axes]

    own, same = widths(), widths(same_scale=True)
    assert own[0] < own[1]
    assert np.isclose(same[0], same[1])
    assert np.isclose(same[1], own[1])


def test_a_single_pose_can_be_drawn():
    for pose in ((1, 2, 3), (1, 2, 3, 0, 0, 0, 1)):
        graph = PoseGraph.from_arrays([], [], ids=[7], poses=[pose])
        assert masat.plot(graph)._repr_png_().startswith(PNG)
        masat.plot(graph, color_by_error=True)


def test_a_graph_without_poses_is_refused():
    graph = masat.PoseGraph.from_arrays([(0, 1)], [(1, 0, 0)])
    with pytest.raises(GraphError, match="'bare' has no poses"):
        masat.plot({"bare": graph})


@pytest.mark.parametrize(
    ("graphs", "options", "said"),
    [
        ({}, {}, "no graph to draw"),
        ({"a": spatial(np.ones(3))}, {"view": "front"}, "unknown view 'front'; known: auto, top"),
        ({"a": spatial(np.ones(3))}, {"columns": 0}, "columns must be at least 1, got 0"),
    ],
)
def test_bad_requests_are_one_clear_error(graphs, options, said):
    with pytest.raises(MasatError, match=said):
        masat.plot(graphs, **options)


EDGES, STEPS = [(0, 1), (1, 2), (2, 0)], [(1, 0, 0), (1, 0, 0), (-2, 0, 0)]
SOLVED = PoseGraph.from_arrays(EDGES, STEPS, poses=[(0, 0, 0), (1, 0, 0), (2, 0, 0)])


def test_before_is_odometry_where_the_file_has_no_poses():
    before, after = before_and_after(PoseGraph.from_arrays(EDGES, STEPS), SOLVED).items()
    assert before[0] == "before: odometry"
    assert np.allclose(before[1].poses, SOLVED.poses)
    assert after == ("after: optimized", SOLVED)


def test_before_are_the_poses_of_the_file():
    own = SOLVED.with_poses([(0, 0, 0), (5, 5, 5), (6, 6, 6)])
    assert before_and_after(own, SOLVED)["before: poses of the input"] is own


@pytest.mark.parametrize("fixed", [(), (1,)])
def test_placeholder_poses_are_not_drawn(fixed):
    poses = np.zeros((3, 3))
    poses[list(fixed)] = (1, 0, 0)
    placeholders = PoseGraph.from_arrays(EDGES, STEPS, poses=poses, fixed=fixed)
    assert "before: odometry" in before_and_after(placeholders, SOLVED)


def test_before_is_the_spanning_tree_where_no_edge_is_odometry():
    graph = PoseGraph.from_arrays([(0, 2), (1, 3), (0, 3)], [(1, 0, 0), (0, 1, 0), (0, 0, 1)])
    before = before_and_after(graph, masat.initialize(graph, "chordal"))
    assert list(before) == ["before: spanning tree", "after: optimized"]


@pytest.mark.parametrize("name", ["2d/kitti_00.g2o", "3d/parking-garage.g2o"])
def test_before_and_after_of_real_graphs_differ(name, data_dir):
    graph = masat.read(data_dir / name)
    result = masat.optimize(masat.initialize(graph, "auto"))
    before, after = before_and_after(graph, result.graph).values()
    assert masat.residuals.chi2_per_edge(before).sum() > 2 * result.chi2
    assert after is result.graph


def robust_result(dimension, kind="random"):
    """A robust solve that rejects some loop closures, and which edges were false."""
    world = manhattan(300, 420, seed=1) if dimension == 2 else grid(125, 230, seed=1)
    clean = perturb(world, [0.02, 0.02, 0.01] if dimension == 2 else [0.02, 0.01], seed=1)
    spoiled, is_false = add_false_closures(clean, kind, 0.2, seed=3)
    return spoiled, masat.solve(spoiled, robust=True), is_false


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("color_by_error", [False, True])
def test_rejected_closures_have_a_panel_of_their_own(dimension, color_by_error):
    _, result, _ = robust_result(dimension)
    count = np.count_nonzero(~result.kept)
    assert count > 0
    figure = masat.plot(result, view="top", color_by_error=color_by_error)
    kept, rejected = figure.axes[:2]
    assert (kept.get_title(), rejected.get_title()) == ("map", "rejected loop closures")
    total = len(result.closures)
    (caption,) = [text.get_text() for text in rejected.texts]
    assert caption == f"{count} of {total} loop closures"
    chain, dashed = lines(rejected)
    assert len(dashed.get_segments()) == count
    assert np.allclose(dashed.get_color()[0][:3], to_rgb(REJECTED))
    ((_, pattern),) = dashed.get_linestyle()
    assert len(pattern) == 2
    # Each line lies where its two nodes do.
    table = result.closures[~result.closures["kept"]]
    ends = result.graph.index([table["from"][0], table["to"][0]])
    assert np.allclose(dashed.get_segments()[0], result.poses[ends, :2])
    assert len(chain.get_segments()) == len(result.graph) - 1
    drawn = sum(len(line.get_segments()) for line in lines(kept))
    assert drawn == len(result.graph.edges)
    assert "rejected loop closures" in legend(figure)


def test_a_result_without_a_decision_has_one_panel():
    assert len(masat.plot(masat.solve(manhattan(100, 150, extent=8))).axes) == 1


def test_a_decision_that_rejected_nothing_has_one_panel():
    _, result, _ = robust_result(2)
    table = result.closures.copy()
    table["kept"] = True
    everything = replace(result, decision=replace(result.decision, closures=table))
    assert len(masat.plot(everything).axes) == 1


def test_before_and_after_a_robust_solve():
    spoiled, result, _ = robust_result(2)
    figure = masat.plot(before_and_after(spoiled, result))
    titles = [ax.get_title() for ax in figure.axes]
    assert titles[1:] == ["after: optimized", "rejected loop closures"]


def test_a_saved_result_is_drawn_as_before(tmp_path):
    _, result, _ = robust_result(2)
    result.save(tmp_path / "result.npz")
    loaded = Result.load(tmp_path / "result.npz")
    assert masat.plot(loaded).encode() == masat.plot(result).encode()
