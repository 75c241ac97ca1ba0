"""The front end in examples/front_end.py runs, and does what its page says."""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest

import masat

EXAMPLES = Path(__file__).parents[1] / "examples"


@pytest.fixture(scope="module")
def front_end():
    spec = importlib.util.spec_from_file_location("front_end", EXAMPLES / "front_end.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules["front_end"] = module
    spec.loader.exec_module(module)
    yield module
    del sys.modules["front_end"]


def test_a_registration_by_hand(front_end):
    """Three beacons, seen after a step of a meter and a left turn by a right angle."""
    one = {1: np.array([2.0, 0, 0]), 2: np.array([0, 3.0, 0]), 3: np.array([0, 0, 1.0])}
    motion = np.array([[0, -1, 0, 1], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])
    other = {k: motion[:3, :3].T @ (p - motion[:3, 3]) for k, p in one.items()}
    assert np.allclose(front_end.registered(one, other), motion)


def test_loop_closures_keep_the_front_end_from_drifting(front_end):
    with_closures, alone = [], []
    for seed in (1, 2, 3, 4):
        runner, path, previous, start = front_end.FrontEnd(), np.eye(4), {}, None
        for pose, scan in front_end.drive(seed=seed):
            runner.process(scan)
            start = pose if start is None else start
            path = path @ front_end.registered(previous, scan) if previous else path
            previous = scan
        end = (np.linalg.inv(start) @ pose)[:3, 3]
        with_closures.append(np.linalg.norm(runner.pose[:3, 3] - end))
        alone.append(np.linalg.norm(path[:3, 3] - end))
        assert len(runner.closures) > 50
    assert np.mean(with_closures) < 0.4 * np.mean(alone)
    # What the map that grows arrives at is the optimum of its graph.
    graph = runner.optimizer.graph()
    assert graph.chi2 <= masat.solve(graph).chi2 * (1 + 1e-3)


def test_the_back_end_has_the_methods_of_kiss_slam(front_end):
    back_end = front_end.PoseGraphOptimizer()
    step = np.eye(4)
    step[0, 3] = 2.0
    back_end.add_variable(0, np.eye(4))
    back_end.fix_variable(0)
    back_end.add_variable(1, np.eye(4))
    back_end.add_factor(0, 1, step, np.eye(6))
    back_end.optimize()
    assert np.allclose(back_end.estimates[1], step)
    with pytest.raises(ValueError, match="only the first pose"):
        back_end.fix_variable(1)


def test_the_program_runs(front_end, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    front_end.main()
    out = capsys.readouterr().out
    assert "with loop closures:" in out
    assert (tmp_path / "front_end.html").exists()
