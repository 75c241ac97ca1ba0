import numpy as np
import pytest
from matplotlib.collections import LineCollection
from random_graphs import random_graph

import masat
from masat import GraphError
from masat.worlds import manhattan


def test_trajectory_and_loop_closures_are_drawn_where_the_poses_are():
    graph = manhattan(200, 300, extent=8)
    figure = masat.plot(graph)
    loops, chain = (c for c in figure.axes[0].collections if isinstance(c, LineCollection))
    assert len(chain.get_segments()) == 199
    assert len(loops.get_segments()) == 101
    assert np.array_equal(chain.get_segments()[0], graph.poses[:2, :2])
    (left, right), (bottom, top) = figure.axes[0].get_xlim(), figure.axes[0].get_ylim()
    assert left < graph.poses[:, 0].min()
    assert right > graph.poses[:, 0].max()
    assert np.isclose(right - left, top - bottom)


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("suffix", ["png", "pdf", "svg"])
def test_a_picture_is_written_in_the_format_of_its_name(dimension, suffix, tmp_path):
    path = tmp_path / f"map.{suffix}"
    masat.plot(random_graph(dimension, 10, 10, seed=1), path)
    begin = {"png": b"\x89PNG", "pdf": b"%PDF", "svg": b"<?xml"}[suffix]
    assert path.read_bytes().startswith(begin)


@pytest.mark.parametrize("dimension", [2, 3])
def test_before_and_after_have_a_panel_each_and_share_the_colors(dimension):
    one, two = (random_graph(dimension, 10, 10, seed=s) for s in (1, 2))
    figure = masat.plot({"before": one, "after": two}, color_by_error=True)
    before, after, scale = figure.axes
    assert (before.get_title(), after.get_title()) == ("before", "after")
    assert scale.get_ylabel() == "chi2 of the edge"
    limits = {c.get_clim() for ax in (before, after) for c in ax.collections}
    assert len(limits) == 1


def test_an_exact_fit_can_be_colored():
    masat.plot(manhattan(100, 150, extent=6), color_by_error=True)


def test_a_single_pose_can_be_drawn():
    masat.plot(masat.PoseGraph.from_arrays([], [], ids=[7], poses=[(1, 2, 3)]))


def test_a_graph_without_poses_is_refused():
    graph = masat.PoseGraph.from_arrays([(0, 1)], [(1, 0, 0)])
    with pytest.raises(GraphError, match="'bare' has no poses"):
        masat.plot({"bare": graph})
