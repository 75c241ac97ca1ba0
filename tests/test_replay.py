"""Graphs that are fed pose by pose to a map that grows, from Python and from the command line."""

import json

import numpy as np
import pytest

import masat
from masat import worlds
from masat.online.stream import replay, steps


@pytest.fixture(scope="module")
def graph():
    world = worlds.perturb(worlds.manhattan(120, 200, seed=2), (0.05, 0.05, 0.03), seed=1)
    return world.with_fixed([])


def test_each_pose_arrives_with_its_edges_to_earlier_ones_odometry_first(graph):
    seen, known = [], set()
    for node, edges, _, _ in steps(graph):
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


def test_landmarks_arrive_with_the_poses_that_see_them(graph):
    seen = masat.landmarks([(7, 900), (5, 900), (7, 901)], [(1, 1)] * 3, ids=[900, 901, 902])
    # Nothing sees landmark 902, and 900 is seen by pose 5 before its fix can arrive.
    fixes = masat.gps([900, 902, 3], [(0, 0)] * 3, 1.0)
    with_landmarks = graph.with_landmarks(seen).with_priors(fixes)
    arrived = list(steps(with_landmarks))
    observations = {s.node: s.observations.tolist() for s in arrived if len(s.observations)}
    assert observations == {5: [1], 7: [0, 2]}
    assert {s.node: s.priors.tolist() for s in arrived if len(s.priors)} == {3: [2], 5: [0]}
    assert replay(with_landmarks).map.point_ids.tolist() == [900, 901]


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


def test_the_command_writes_landmarks(run, tmp_path):
    truth = worlds.manhattan(40, 60, seed=2)
    world = worlds.perturb(truth, (0.05, 0.05, 0.03), seed=1).with_poses(truth.poses)
    graph = worlds.add_landmarks(world, 8, seed=1).with_fixed([])
    fixes = masat.gps([0, 20, 39], truth.poses[[0, 20, 39], :2] + 100, 0.1)
    graph = graph.with_priors(fixes)
    masat.write(graph, tmp_path / "in.g2o")
    code, out, _ = run("replay", "in.g2o", "-o", "out.g2o")
    assert code == 0
    assert "3 priors" in out
    assert "observations of 8 landmarks" in out
    written = masat.read(tmp_path / "out.g2o")
    assert written.points.shape == (8, 2)
    assert written.chi2 == pytest.approx(masat.solve(graph).chi2, rel=1e-4)
    assert "waiting  " not in out
    masat.write(graph.with_priors(fixes.rows([0])), tmp_path / "one.g2o")
    code, out, _ = run("replay", "one.g2o")
    assert code == 0
    assert "waiting  1 prior that does not determine yet" in out
