"""Priors, landmarks and partial edges of maps in parts."""

import numpy as np
import pytest

import masat
from masat import PartitionError
from masat.worlds import add_fixes, add_landmarks, city, perturb, sphere


def with_fixes():
    world = city(400, seed=3)
    noisy = perturb(world, (0.05, 0.05, 0.02), seed=3).with_poses(world.poses)
    return add_fixes(noisy, 0.2, 0.5, seed=3)[0]


def with_landmarks(world, sigmas):
    noisy = perturb(world, sigmas, seed=2).with_poses(world.poses)
    return add_landmarks(noisy, 30, sigma=0.1, reach=6, seed=2)


def with_partial_edges():
    graph = with_landmarks(sphere(200), (0.05, 0.02))
    information = graph.information.copy()
    # What a sensor of bearings alone would tell.
    information[::7, 0, :] = information[::7, :, 0] = 0
    return masat.PoseGraph.from_arrays(
        graph.edges,
        graph.measurements,
        information,
        poses=graph.poses,
        landmarks=graph.landmarks,
        priors=masat.pose_priors([17], graph.poses[17:18], np.diag([1.0, 1, 1, 9, 9, 9])),
    )


def with_bearings(world, sigmas, arm):
    noisy = perturb(world, sigmas, seed=4).with_poses(world.poses)
    seen = add_landmarks(noisy, 30, sigma=0.1, reach=6, sigma_bearing=0.02, seed=4)
    at = world.poses[::20, : world.dimension]
    return seen.with_priors(masat.gps(world.ids[::20], at, 0.3, lever_arm=arm))


GRAPHS = {
    "bearings and lever arms": lambda: with_bearings(
        city(400, seed=2), (0.05, 0.05, 0.02), (0.3, 0.1)
    ),
    "the same in 3D": lambda: with_bearings(sphere(200), (0.05, 0.02), (0.3, 0.1, 0.2)),
    "fixes": with_fixes,
    "landmarks": lambda: with_landmarks(city(400, seed=2), (0.05, 0.05, 0.02)),
    "both in 3D, partial edges": with_partial_edges,
}


@pytest.mark.parametrize("name", GRAPHS)
def test_a_solve_in_parts_is_that_of_one_process(tmp_path, name):
    graph = masat.initialize(GRAPHS[name](), "masat")
    made = masat.partition(graph, tmp_path / "parts", 3)
    found, whole = made.solve("lm"), masat.optimize(graph)
    assert found.converged
    assert found.initial_chi2 == pytest.approx(whole.initial_chi2, rel=1e-9)
    assert found.chi2 == pytest.approx(whole.chi2, rel=1e-9)
    ids, poses = made.poses()
    assert np.array_equal(ids, graph.ids)
    assert np.abs(masat.lie.local(whole.poses, poses)).max() < 1e-5
    if graph.landmarks is not None:
        ids, points = made.points()
        assert np.array_equal(ids, graph.point_ids)
        assert np.allclose(points, whole.graph.points, atol=1e-5)
    assert made.graph().chi2 == pytest.approx(found.chi2, rel=1e-9)


@pytest.mark.parametrize("loss", ["cauchy", "tukey"])
@pytest.mark.parametrize("name", GRAPHS)
def test_a_loss_in_parts_is_that_of_one_process(tmp_path, name, loss):
    graph = masat.optimize(masat.initialize(GRAPHS[name](), "masat")).graph
    made = masat.partition(graph, tmp_path / "parts", 3)
    found, whole = made.solve("lm", loss=loss), masat.optimize(graph, "lm", loss=loss)
    assert (found.reason, found.iterations) == (whole.reason, whole.iterations)
    assert found.robust_cost == pytest.approx(whole.robust_cost, rel=1e-8)
    assert found.chi2 == pytest.approx(whole.chi2, rel=1e-6)


@pytest.mark.parametrize("name", GRAPHS)
def test_the_graph_that_was_cut_comes_back(tmp_path, name):
    graph = GRAPHS[name]()
    back = masat.partition(graph, tmp_path / "parts", 3).graph()
    pairs = (graph, back), (graph.priors, back.priors), (graph.landmarks, back.landmarks)
    for one, other in pairs:
        assert (one is None) == (other is None)
        for field in ("ids", "edges", "information", "observations", "positions", "offsets"):
            if getattr(one, field, None) is not None:
                assert np.array_equal(getattr(one, field), getattr(other, field)), field
        if one is not None:
            assert np.allclose(one.measurements, other.measurements, rtol=0, atol=1e-12)
    assert np.array_equal(back.gauge, graph.gauge)


def test_a_guess_is_made_where_there_is_none(tmp_path):
    graph = with_fixes()
    bare = masat.PoseGraph.from_arrays(
        graph.edges, graph.measurements, graph.information, priors=graph.priors
    )
    made = masat.partition(bare, tmp_path / "parts", 3)
    assert made.solve().chi2 == pytest.approx(masat.optimize(graph).chi2, rel=1e-6)
    with pytest.raises(PartitionError, match="keep the initial guess"):
        made.solve(init="spanning_tree", restart=True)


def test_landmarks_are_with_the_first_pose_that_saw_them(tmp_path):
    graph = GRAPHS["landmarks"]()
    half = np.arange(len(graph)) // (len(graph) // 2)
    made = masat.partition(graph, tmp_path / "parts", labels=half)
    assert made.index.parts == 2
    assert made.solve().chi2 == pytest.approx(masat.optimize(graph).chi2, rel=1e-9)


def test_what_is_not_determined_is_said_and_kept(tmp_path):
    graph = with_fixes()
    # A node that one position fix alone ties to the world may turn.
    added = masat.PoseGraph.from_arrays(
        graph.edges,
        graph.measurements,
        graph.information,
        ids=[*graph.ids, 10_000],
        poses=[*graph.poses, (1, 2, 0.5)],
        priors=graph.priors + masat.gps([10_000], [(1.0, 2.0)], 0.5),
    )
    made = masat.partition(added, tmp_path / "parts", 3)
    assert any("10000" in note for note in made.index.notes)
    assert made.solve().converged
    ids, poses = made.poses()
    assert poses[ids == 10_000][0] == pytest.approx((1, 2, 0.5))


def test_the_command_line_cuts_and_solves_them(run, tmp_path):
    graph, file, out = with_partial_edges(), tmp_path / "map.g2o", tmp_path / "solved.g2o"
    masat.write(graph, file)
    _, said, _ = run("partition", file, "--parts", "2", "-o", tmp_path / "parts")
    assert "priors" in said
    assert "landmarks" in said
    run("solve", tmp_path / "parts", "-o", out)
    solved = masat.read(out)
    assert solved.chi2 == pytest.approx(masat.optimize(graph).chi2, rel=1e-6)
    assert len(solved.landmarks) == len(graph.landmarks)
