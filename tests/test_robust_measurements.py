"""Wrong priors, observations of landmarks and partial edges are found beside false closures."""

import math

import numpy as np
import pytest

import masat
from masat import quantiles, worlds
from masat.robust import decide


@pytest.fixture(scope="module")
def truth():
    return worlds.manhattan(400, 1200, seed=3)


@pytest.fixture(scope="module")
def noisy(truth):
    return worlds.perturb(truth, (0.02, 0.02, 0.02), seed=1)


def with_fixes(truth, noisy, *, bad, seed=0, sigma=0.1, promised=None, fraction=0.2):
    """Return the noisy graph with fixes of the true poses, of which some are 50 m off."""
    world, is_bad = worlds.add_fixes(
        truth, fraction, sigma, bad=bad, frame=(700.0, -300.0, 2.5), seed=seed
    )
    priors = world.priors
    if promised is not None:
        priors = masat.gps(priors.ids, priors.measurements[:, :2], promised)
    return noisy.with_priors(priors), is_bad


@pytest.mark.parametrize("seed", range(3))
def test_a_third_of_bad_fixes_leaves_the_clean_map(truth, noisy, seed):
    graph, is_bad = with_fixes(truth, noisy, bad=0.3, seed=seed)
    result = masat.solve(graph, robust=True)
    assert is_bad.sum() == 24
    assert (result.decision.kept_priors == ~is_bad).all()
    assert result.kept.all()
    clean = masat.solve(graph.with_priors(graph.priors.rows(~is_bad)))
    assert np.isclose(result.chi2, clean.chi2, rtol=1e-9)
    assert np.allclose(result.poses, clean.poses, atol=1e-5)
    rejected = result.decision.to_dict()["rejected_measurements"]
    assert sorted(row["row"] for row in rejected) == np.flatnonzero(is_bad).tolist()
    assert {row["node"] for row in rejected} == set(graph.priors.ids[is_bad].tolist())


def test_good_fixes_are_kept(truth, noisy):
    graph, _ = with_fixes(truth, noisy, bad=0.0)
    result = masat.solve(graph, robust=True)
    assert result.decision.kept_priors.all()
    assert np.isclose(result.chi2, masat.solve(graph).chi2, rtol=1e-9)


def test_fixes_that_promise_too_much_are_not_all_rejected(truth, noisy):
    graph, is_bad = with_fixes(truth, noisy, bad=0.2, sigma=1.0, promised=0.05)
    kept = decide(graph).kept_priors
    assert not kept[is_bad].any()
    assert kept[~is_bad].mean() > 0.9


def test_fixes_and_closures_are_judged_in_one_solve(truth, noisy):
    spoiled, is_false = worlds.add_false_closures(masat.solve(noisy).graph, "random", 0.3, seed=2)
    graph, is_bad = with_fixes(truth, spoiled, bad=0.3)
    decision = masat.solve(graph, robust=True).decision
    assert not decision.kept[is_false].any()
    assert decision.kept[~is_false].mean() > 0.98
    assert (decision.kept_priors == ~is_bad).all()
    assert "priors and observations kept" in repr(decision)


def test_of_two_contradictory_fixes_one_is_kept():
    # Two nodes a meter apart by odometry; the fixes say a hundred.
    graph = masat.PoseGraph.from_arrays(
        edges=[(0, 1)],
        measurements=[(1, 0, 0)],
        priors=masat.gps([0, 1], [(0, 0), (100, 0)], 0.1),
    )
    decision = decide(graph)
    assert decision.kept_priors.sum() == 1


def test_a_wrong_observation_of_a_landmark_is_rejected(truth):
    world = worlds.add_landmarks(truth, 40, sigma=0.05, reach=6.0, seed=4)
    seen = world.landmarks
    count = np.bincount(np.searchsorted(seen.ids, seen.observations[:, 1]))
    row = int(np.flatnonzero(count[np.searchsorted(seen.ids, seen.observations[:, 1])] >= 4)[0])
    measured = seen.measurements.copy()
    measured[row] += (8.0, -5.0)
    graph = worlds.perturb(world, (0.02, 0.02, 0.02), seed=1)
    wrong = masat.landmarks(seen.observations, measured, information=seen.information)
    decision = masat.solve(graph.with_landmarks(wrong), robust=True).decision
    assert np.flatnonzero(~decision.kept_observations).tolist() == [row]
    table = decision.measurements[~decision.measurements["kept"]]
    assert table["landmark"].tolist() == [seen.observations[row, 1]]
    assert table["reason"].tolist() == ["contradicts the rest of the map"]


def test_a_wrong_partial_edge_is_rejected(noisy):
    poses = masat.solve(noisy).poses
    position = np.diag([100.0, 100.0, 0.0])
    a, b = np.array([10, 60, 200]), np.array([300, 350, 390])
    z = masat.lie.between(poses[a], poses[b])
    z[1, :2] += 20.0
    ids = noisy.ids
    graph = masat.PoseGraph.from_arrays(
        edges=np.concatenate([noisy.edges, np.stack([ids[a], ids[b]], 1)]),
        measurements=np.concatenate([noisy.measurements, z]),
        information=np.concatenate([noisy.information, np.tile(position, (3, 1, 1))]),
    )
    result = masat.solve(graph, robust=True)
    m = len(noisy.edges)
    assert np.flatnonzero(~result.kept).tolist() == [m + 1]
    assert result.closures["edge"][~result.closures["kept"]].tolist() == [m + 1]


def test_a_decision_on_fixes_is_saved(truth, noisy, tmp_path):
    graph, is_bad = with_fixes(truth, noisy, bad=0.3)
    result = masat.solve(graph, robust=True)
    result.save(tmp_path / "result.npz")
    again = masat.optimizers.Result.load(tmp_path / "result.npz")
    assert (again.decision.measurements == result.decision.measurements).all()
    assert (again.decision.kept_priors == ~is_bad).all()


def test_few_kept_fixes_are_noted(truth, noisy):
    graph, _ = with_fixes(truth, noisy, bad=0.45)
    with pytest.warns(masat.MasatWarning, match=r"only \d+ of 80 priors are kept"):
        masat.solve(graph, robust=True)


@pytest.mark.parametrize(
    ("table", "below"),
    [
        (quantiles.TENTH, 0.1),
        (quantiles.QUARTER, 0.25),
        (quantiles.MEDIAN, 0.5),
        (quantiles.LOSS_GATE, 0.99),
        (quantiles.GATE, 0.999),
        (quantiles.FAR_GATE, 1 - 1e-5),
    ],
)
def test_quantiles_of_chi2(table, below):
    for dof, value in table.items():
        # The series of the regularized lower incomplete gamma function.
        a, x = dof / 2, value / 2
        term = total = 1 / a
        for k in range(1, 500):
            term *= x / (a + k)
            total += term
        assert total * math.exp(a * math.log(x) - x - math.lgamma(a)) == pytest.approx(
            below, abs=5e-3 * min(below, 1 - below)
        )


def test_the_command_line_tells_and_writes_what_is_rejected_and_nothing_else(run, truth, noisy):
    graph, is_bad = with_fixes(truth, noisy, bad=0.2)
    seen = worlds.add_landmarks(graph.with_poses(truth.poses), 40, sigma=0.05, reach=6, seed=1)
    wrong = seen.landmarks.measurements.copy()
    wrong[7] += 3
    points = masat.landmarks(
        seen.landmarks.observations, wrong, seen.landmarks.information, ids=seen.point_ids
    )
    graph, is_false = worlds.add_false_closures(
        graph.with_poses(truth.poses).with_landmarks(points), "random", 0.1, seed=2
    )
    masat.write(graph, "g.g2o")
    arguments = ("--robust", "--rejected", "rejected.g2o", "-o", "map.g2o")
    for command in ("solve", "merge"):
        code, out, _ = run(command, "g.g2o", *arguments)
        assert code == 0
        said = dict(line.split("  ", 1) for line in out.splitlines() if "  " in line)
        assert said["priors"].strip() == f"{(~is_bad).sum()} of {len(is_bad)} kept"
        assert said["observations"].strip() == f"{len(wrong) - 1} of {len(wrong)} kept"
        first = graph.priors.ids[is_bad][0]
        assert f"{is_bad.sum()} priors: contradicts the rest of the map (node {first}, " in out
        pose, point = points.observations[7]
        assert f"1 observation: contradicts the rest of the map ({pose} -> {point})" in out
        rejected = masat.read("rejected.g2o")
        assert np.array_equal(rejected.edges, graph.edges[is_false])
        assert np.array_equal(rejected.priors.ids, graph.priors.ids[is_bad])
        assert rejected.landmarks.observations.tolist() == [[pose, point]]
        assert rejected.point_ids.tolist() == [point]
        solved = masat.read("map.g2o")
        assert np.array_equal(rejected.poses, solved.poses)
        assert np.array_equal(rejected.points[0], solved.points[solved.point_ids == point][0])


def test_the_rejected_prior_of_a_landmark_is_written(run):
    walk = [(k, k + 1) for k in range(5)]
    graph = masat.PoseGraph.from_arrays(
        walk,
        [(1, 0, 0)] * 5,
        np.diag([100, 100, 400]),
        priors=masat.gps([*range(6), 9], [*((k, 0) for k in range(6)), (70, 70)], 0.1),
        landmarks=masat.landmarks(
            [(k, 9) for k in range(6)], [(3 - k, 2) for k in range(6)], np.eye(2) * 100
        ),
    )
    masat.write(graph, "g.g2o")
    code, out, _ = run("solve", "g.g2o", "--robust", "--rejected", "rejected.g2o")
    assert code == 0
    assert "6 of 7 kept" in out
    assert "1 prior: contradicts the rest of the map (node 9)" in out
    rejected = masat.read("rejected.g2o")
    assert (len(rejected.edges), rejected.priors.ids.tolist()) == (0, [9])
    assert len(rejected.landmarks.observations) == 0


def test_an_observation_far_off_takes_no_honest_one_with_it(truth):
    world = worlds.add_landmarks(truth, 40, sigma=0.05, reach=6.0, seed=1)
    world, _ = worlds.add_fixes(world, 0.2, 0.1, frame=(700.0, -300.0, 2.5))
    graph = worlds.perturb(world, (0.02, 0.02, 0.02), seed=1)
    seen = graph.landmarks
    measured = seen.measurements.copy()
    measured[7] += 30.0
    wrong = masat.landmarks(seen.observations, measured, information=seen.information)
    decision = decide(graph.with_landmarks(wrong))
    assert np.flatnonzero(~decision.kept_observations).tolist() == [7]
    assert decision.kept_priors.all()


def test_a_wrong_bearing_is_rejected(truth):
    world = worlds.add_landmarks(truth, 40, sigma=0.05, reach=6.0, seed=4)
    world, _ = worlds.add_fixes(world, 0.2, 0.1, seed=4)
    seen = world.landmarks
    ahead = seen.measurements
    bearings = np.arctan2(ahead[:, 1], ahead[:, 0])
    bearings[7] += 1.0
    ranges = np.hypot(*ahead.T)
    polar = masat.range_bearing(
        seen.observations, ranges, bearings, sigma_range=0.05, sigma_bearing=0.05 / ranges
    )
    graph = worlds.perturb(world.with_landmarks(polar), (0.02, 0.02, 0.02), seed=1)
    decision = decide(graph)
    assert np.flatnonzero(~decision.kept_observations).tolist() == [7]
    assert decision.kept_priors.all()
