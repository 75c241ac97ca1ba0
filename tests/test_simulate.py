import json
from functools import partial

import numpy as np
import pytest

import masat
from masat.worlds import WORLDS, perturb


@pytest.fixture
def simulate(run):
    """Run `masat simulate`."""
    return partial(run, "simulate")


@pytest.mark.parametrize("world", WORLDS)
def test_a_world_is_written_without_poses_and_its_truth_with_them(simulate, world):
    sigma = "0.1,0.1,0.05" if world in ("manhattan", "city") else "0.1,0.05"
    code, text, err = simulate(
        world, "--nodes", 300, "--edges", 400, "--noise", sigma, "--seed", 3, "-o", "w.g2o",
        "--truth", "truth.g2o",
    )  # fmt: skip
    assert (code, err) == (0, "")
    assert text == "w.g2o: 300 nodes, 400 edges\n"
    truth = WORLDS[world](300, 400, seed=3)
    noisy = perturb(truth, [float(s) for s in sigma.split(",")], seed=3)
    written, exact = masat.read("w.g2o"), masat.read("truth.g2o")
    assert written.poses is None
    assert np.array_equal(written.measurements, noisy.measurements)
    assert np.array_equal(written.information, noisy.information)
    assert np.array_equal(exact.poses, truth.poses)
    assert np.array_equal(exact.measurements, truth.measurements)


def test_without_noise_measurements_are_exact(simulate):
    assert simulate("city", "-o", "city.g2o.gz", "--nodes", 500, "--quiet") == (0, "", "")
    assert np.array_equal(masat.read("city.g2o.gz").measurements, WORLDS["city"](500).measurements)


def test_noise_may_be_given_number_by_number(simulate):
    simulate("grid", "-o", "a.g2o", "--nodes", 64, "--noise", "0.1,0.2")
    simulate("grid", "-o", "b.g2o", "--nodes", 64, "--noise", "0.1", "--noise", "0.2")
    assert masat.read("a.g2o").information[0, 0, 0] == pytest.approx(100)
    one, other = (masat.read(f).measurements for f in ("a.g2o", "b.g2o"))
    assert np.array_equal(one, other)


def test_it_prints_json_and_draws(simulate, tmp_path):
    code, text, _ = simulate("torus", "-o", "t.g2o", "--nodes", 200, "--plot", "t.png", "--json")
    assert code == 0
    said = json.loads(text)
    assert said["world"] == "torus"
    assert said["nodes"] == 200
    assert said["noise"] == []
    assert (tmp_path / "t.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["mars", "-o", "w.g2o"], "mars"),
        (["city"], "--output"),
        (["city", "-o", "no/such/w.g2o"], "folder does not exist"),
        (["city", "-o", "w.g2o", "--truth", "w.g2o"], "choose different names"),
        (["city", "-o", "w.csv"], "the suffix '.csv' belongs to no format"),
        (["city", "-o", "w.g2o", "--truth", "w.png"], "the suffix '.png' belongs to no format"),
        (["city", "-o", "w.g2o", "--nodes", 2**31], "at most 2147483647 nodes"),
        (["city", "-o", "w.g2o", "--nodes", 100, "--noise", "1,1,1e-200"], "between 1e-100"),
        (["city", "-o", "w.g2o", "--plot", "w.xyz"], "a picture ends in"),
        (["city", "-o", "w.g2o", "--nodes", 100, "--edges", 50], "an edge between"),
        (["city", "-o", "w.g2o", "--nodes", 100, "--edges", 9999], "loop closures"),
        (["city", "-o", "w.g2o", "--nodes", 100, "--noise", "0.1"], "3 sigmas"),
        (["city", "-o", "w.g2o", "--nodes", 100, "--noise", "a,b,c"], "expected numbers"),
        (["grid", "-o", "w.g2o", "--nodes", 100, "--noise", "0.1,-1"], "not negative"),
    ],
)
def test_bad_usage_is_code_2_and_writes_nothing(simulate, tmp_path, arguments, said):
    code, out, err = simulate(*arguments)
    assert (code, out) == (2, "")
    assert said in err
    assert "Traceback" not in err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("world", "sigma", "frame"),
    [("manhattan", "0.05,0.05,0.02", "500,200,120"), ("sphere", "0.05,0.02", "500,200,5,120")],
)
def test_fixes_and_landmarks_are_written(simulate, world, sigma, frame):
    code, text, err = simulate(
        world, "--nodes", 400, "--noise", sigma, "--gps", "0.1:0.5:0.2", "--frame", frame,
        "--landmarks", "20:0.1:6", "-o", "w.g2o", "--truth", "truth.g2o",
    )  # fmt: skip
    assert (code, err) == (0, "")
    assert "40 fixes, 8 of them bad, 20 landmarks with 200 observations" in text
    graph, truth = masat.read("w.g2o"), masat.read("truth.g2o")
    assert (graph.poses, graph.points) == (None, None)
    assert (len(graph.priors), len(graph.landmarks)) == (40, 20)
    assert truth.chi2 < 1e-6
    d = graph.dimension
    assert np.array_equal(truth.poses[0, :d].round(), [500, 200, 5][:d]) or world == "sphere"
    distance = np.linalg.norm(
        graph.priors.measurements[:, :d] - truth.poses[truth.index(graph.priors.ids), :d], axis=1
    )
    assert (distance > 40).sum() == 8


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--gps", "0.1"), "as in 0.05:2"),
        (("--gps", "0.1:x"), "as in 0.05:2"),
        (("--gps", "2:1"), "must be from 0 to 1"),
        (("--landmarks", "many"), "as in 200"),
        (("--landmarks", "3:1:2:3:4"), "as in 200"),
        (("--frame", "1,2,3"), "--frame is the frame of --gps"),
        (("--gps", "0.1:1", "--frame", "1,2"), "needs 3 numbers: EAST,NORTH,HEADING"),
    ],
)
def test_bad_fixes_and_landmarks_are_refused(simulate, arguments, message):
    code, _, err = simulate("manhattan", "--nodes", 100, *arguments, "-o", "w.g2o")
    assert code == 2
    assert message in err
