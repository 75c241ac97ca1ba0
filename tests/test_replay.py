"""Graphs that are fed pose by pose to a map that grows, from Python and from the command line."""

import json

import numpy as np
import pytest

import masat
from masat import GraphError, worlds
from masat.online.stream import replay, steps


@pytest.fixture(scope="module")
def graph():
    world = worlds.perturb(worlds.manhattan(120, 200, seed=2), (0.05, 0.05, 0.03), seed=1)
    return world.with_fixed([])


def test_each_pose_arrives_with_its_edges_to_earlier_ones_odometry_first(graph):
    seen, known = [], set()
    for node, edges, _ in steps(graph):
        known.add(node)
        for edge in edges:
            assert set(graph.edges[edge].tolist()) <= known
            assert node in graph.edges[edge]
        if len(edges):
            assert abs(int(np.diff(graph.edges[edges[0]])[0])) == 1
        seen += edges.tolist()
    assert sorted(seen) == list(range(len(graph.edges)))


def test_the_map_of_a_replay_is_that_of_a_solve(graph):
    counts = []
    run = replay(graph, report=lambda done, online: counts.append((done, len(online))))
    assert counts == [(k, k) for k in range(1, 121)]
    assert (run.seconds > 0).all()
    assert run.map.optimize().chi2 == pytest.approx(masat.solve(graph).chi2, rel=1e-6)


def test_priors_arrive_with_their_poses(graph):
    fixed = graph.with_priors(masat.gps([0, 5, 5], [(0, 0), (1, 1), (1, 2)], 1.0))
    arrived = {step.node: step.priors.tolist() for step in steps(fixed) if len(step.priors)}
    assert arrived == {0: [0], 5: [1, 2]}


def test_landmarks_are_refused(graph):
    seen = graph.with_landmarks(masat.landmarks([(0, 10_000)], [(1, 1)]))
    with pytest.raises(GraphError, match="no landmarks yet"):
        replay(seen)


def test_the_command_prints_times_and_writes_map_and_film(run, tmp_path):
    world = worlds.perturb(worlds.manhattan(20, 30, seed=2), (0.05, 0.05, 0.03), seed=1)
    masat.write(world.with_fixed([]), tmp_path / "in.g2o")
    code, out, _ = run("replay", "in.g2o", "-o", "out.g2o", "--film", "grown.gif", "--json")
    assert code == 0
    about = json.loads(out)
    assert about["steps"] == 20
    assert about["median_ms"] <= about["p99_ms"] <= about["max_ms"]
    assert about["chi2"] >= about["optimum"] * (1 - 1e-9)
    assert masat.read(tmp_path / "out.g2o").chi2 == pytest.approx(about["optimum"], rel=1e-9)
    from PIL import Image

    with Image.open(tmp_path / "grown.gif") as picture:
        assert picture.n_frames == 20


def test_the_command_says_how_long_steps_take(graph, run, tmp_path):
    masat.write(graph, tmp_path / "in.g2o")
    code, out, _ = run("replay", "in.g2o")
    assert code == 0
    for words in ("120, with", "median", "99 % within", "above it", "nothing: name a file"):
        assert words in out


def test_a_graph_without_noise_is_not_compared_with_rounding(run, tmp_path):
    masat.write(worlds.manhattan(30, 40, seed=1), tmp_path / "in.g2o")
    code, out, _ = run("replay", "in.g2o")
    assert code == 0
    assert "there up to rounding" in out


def test_a_film_of_another_kind_is_refused_before_the_work_begins(graph, run, tmp_path):
    masat.write(graph, tmp_path / "in.g2o")
    code, _, err = run("replay", "in.g2o", "--film", "film.avi")
    assert code == 2
    assert "a film is a .gif or a .mp4" in err
