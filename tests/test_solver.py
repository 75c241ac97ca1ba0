"""The front door: from a graph to a map in one call."""

import json
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from random_graphs import random_graph

import masat
from masat import MasatError, OptimizationError, PoseGraph, StopReason, _core
from masat.progress import Progress
from masat.worlds import manhattan, perturb, sphere


def noisy(sigma=0.2, nodes=300):
    return perturb(manhattan(nodes, 2 * nodes, extent=12, seed=1), [sigma] * 3, seed=1)


def test_solve_is_the_initial_guess_and_the_optimizer():
    graph = noisy()
    result = masat.solve(graph, init="masat", optimizer="gn")
    by_hand = masat.optimize(masat.initialize(graph, "masat"), "gauss_newton")
    assert np.array_equal(result.poses, by_hand.poses)
    assert (result.init, result.method) == ("masat", "gauss_newton")
    assert result.certificate is None
    assert result.init_seconds > 0


def test_solve_needs_no_guess_and_certifies_on_request():
    result = masat.solve(noisy(0.05), certify=True)
    assert result.converged
    assert result.init == "auto"
    assert result.certificate.certified


@pytest.mark.parametrize("root", [0, 7, 250])
@pytest.mark.parametrize("init", ["auto", "masat", "odometry", "chordal"])
def test_the_root_is_at_the_identity_and_not_optimized(root, init):
    result = masat.solve(noisy(0.1), init=init, root=root)
    assert (result.poses[root] == 0).all()
    assert result.gauge.tolist() == [root]


@pytest.mark.parametrize("short", ["gn", "lm", "dogleg"])
def test_short_names_of_optimizers(short):
    graph = masat.initialize(noisy(0.05), "chordal")
    full = {"gn": "gauss_newton", "lm": "levenberg_marquardt"}.get(short, short)
    assert masat.optimize(graph, short).method == full


def test_one_system_serves_a_whole_solve(monkeypatch):
    made = []
    original = _core.NormalEquations

    def counted(topology, *rest):
        made.append(topology)
        return original(topology, *rest)

    graph = noisy(0.05)
    monkeypatch.setattr(_core, "NormalEquations", counted)
    masat.solve(graph, certify=True)
    assert len(made) == 1


def test_the_first_of_parallel_odometry_edges_counts():
    graph = PoseGraph.from_arrays(
        [(0, 1), (0, 1), (1, 2), (2, 1)], [(1, 0, 0), (5, 0, 0), (1, 0, 0), (-7, 0, 0)]
    )
    assert masat.initialize(graph, "odometry").poses[:, 0].tolist() == [0, 1, 2]


def hard():
    """A graph whose first minimum does not look global, so that a search begins."""
    return perturb(manhattan(2000, 2600, seed=3), [0.3] * 3, seed=3)


def test_a_budget_ends_the_search_with_the_best_so_far():
    result = masat.solve(hard(), budget=0.0)
    assert result.reason is StopReason.INTERRUPTED
    assert np.isfinite(result.poses).all()
    assert result.chi2 <= result.initial_chi2
    with pytest.raises(OptimizationError, match="budget must not be negative"):
        masat.solve(hard(), budget=-1)


def test_stages_are_reported_with_the_lowest_chi2():
    stages = []
    result = masat.solve(hard(), report_stage=stages.append)
    costs = [stage.chi2 for stage in stages if stage.chi2 is not None]
    assert any("searching" in stage.what for stage in stages)
    assert costs[-1] >= result.chi2 * (1 - 1e-6)
    assert all(stage.seconds >= 0 for stage in stages)


def test_ctrl_c_returns_the_best_so_far():
    def interrupt():
        time.sleep(0.3)
        signal.raise_signal(signal.SIGINT)

    graph = perturb(sphere(1500, seed=1), [0.4, 0.4], seed=1)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        threading.Thread(target=interrupt, daemon=True).start()
        result = masat.solve(graph)
    finally:
        signal.signal(signal.SIGINT, before)
    assert result.reason is StopReason.INTERRUPTED
    assert np.isfinite(result.poses).all()


def test_without_leave_to_catch_it_an_interrupt_is_raised():
    def interrupting(_):
        raise KeyboardInterrupt

    graph = masat.initialize(noisy(), "odometry")
    with pytest.raises(KeyboardInterrupt):
        masat.optimize(graph, report=interrupting)
    caught = masat.optimize(graph, report=interrupting, progress=Progress(catch_interrupts=True))
    assert caught.reason is StopReason.INTERRUPTED
    assert caught.chi2 < caught.initial_chi2


def test_wrong_closures_are_named_early():
    graph = perturb(manhattan(400, 700, extent=14, seed=2), [0.02] * 3, seed=2)
    wrong = [(3, 300), (50, 390), (120, 20)]
    spoiled = graph.with_edges(wrong, [(9, 9, 1)] * 3, np.diag([2500.0] * 3))
    stages = []
    with pytest.warns(masat.MasatWarning, match="contradict the map"):
        result = masat.solve(spoiled, report_stage=stages.append, budget=20)
    (warning, *_) = [stage for stage in stages if stage.warning]
    assert "contradict the map far beyond their information" in warning.what
    assert any("contradict" in note for note in result.graph.notes)
    plain = masat.solve(graph)
    assert not any("contradict" in note for note in plain.graph.notes)


def test_correlated_information_needs_no_search():
    """The check is of chi2 itself where the isotropic one fails."""
    rng = np.random.default_rng(0)
    graph = perturb(manhattan(400, 700, extent=14, seed=2), [0.05] * 3, seed=2)
    scale = 20 * rng.uniform(0.5, 1.5, (len(graph.edges), 3))
    correlation = np.eye(3) + 0.4 * (np.ones((3, 3)) - np.eye(3))
    w = scale[:, :, None] * scale[:, None] * np.linalg.inv(correlation)
    stages = []
    result = masat.solve(
        PoseGraph.from_arrays(graph.edges, graph.measurements, w),
        certify=True,
        report_stage=stages.append,
    )
    assert result.certificate.certified
    assert not any("searching" in stage.what for stage in stages)


@pytest.mark.parametrize("method", ["gn", "lm", "dogleg"])
def test_opposite_half_turns_are_no_minimum(method):
    """Two edges say that node 1 is turned by half a turn about x, each by its own way."""
    turn = [0, 0, 0, 1, 0, 0, 0]
    still = [0, 0, 0, 0, 0, 0, 1]
    graph = PoseGraph.from_arrays([(0, 1), (0, 1)], [turn, still], poses=[still, still])
    # From the pose of the second measurement the first is off by half a turn: sin^2 of 90 degrees.
    result = masat.optimize(graph, method)
    assert result.converged
    # In between, both are off by 90 degrees: 2 sin^2 of 45 degrees; no pose has less.
    assert np.isclose(result.chi2, 1.0)
    about_y = [0, 0, 0, 0, 1, 0, 0]
    worst = masat.optimize(
        PoseGraph.from_arrays([(0, 1), (0, 1)], [turn, turn], poses=[still, about_y]), method
    )
    assert worst.chi2 < 1e-9


@pytest.mark.parametrize("method", ["gn", "lm", "dogleg"])
def test_a_triangle_of_sixty_degree_turns_is_spread_evenly(method):
    """One edge off by half a turn is a stationary point of chi2 1; even shares have 3 / 4."""
    third = [0, 0, 0, 0, 0, np.sin(np.pi / 6), np.cos(np.pi / 6)]
    angles = [0, np.pi / 3, 2 * np.pi / 3]
    poses = [[0, 0, 0, 0, 0, np.sin(a / 2), np.cos(a / 2)] for a in angles]
    graph = PoseGraph.from_arrays([(0, 1), (1, 2), (2, 0)], [third] * 3, poses=poses)
    assert np.isclose(graph.chi2, 1.0)
    result = masat.optimize(graph, method)
    assert result.converged
    assert np.isclose(result.chi2, 0.75)


@pytest.mark.parametrize("method", ["gn", "lm", "dogleg"])
def test_a_heading_residual_of_pi_is_left(method):
    graph = PoseGraph.from_arrays(
        [(0, 1), (1, 2), (2, 0)],
        [(0, 0, np.pi), (0, 0, 0), (0, 0, 0)],
        poses=np.zeros((3, 3)),
    )
    result = masat.optimize(graph, method)
    assert result.converged
    assert np.isclose(result.chi2, 3 * (np.pi / 3) ** 2)


def test_a_graph_that_fits_exactly_needs_no_factorization():
    chain = PoseGraph.from_arrays(
        [(k, k + 1) for k in range(20000)], np.tile([1.0, 0, 0], (20000, 1))
    )
    result = masat.solve(chain, init="odometry")
    assert result.converged
    assert result.iterations == 0


def test_threads_are_checked_and_chosen():
    graph = masat.initialize(noisy(), "chordal")
    for threads in (0, -1, 2048):
        with pytest.raises(OptimizationError, match="threads must be from 1"):
            masat.optimize(graph, threads=threads)
    one, many = (masat.optimize(graph, threads=n).poses for n in (1, 3))
    assert np.array_equal(one, many)
    assert np.array_equal(one, masat.optimize(graph).poses)


def test_errors_are_of_the_package():
    graph = random_graph(2, 4, 2, seed=0)
    for wrong in ({"init": "x"}, {"optimizer": "x"}, {"root": 99}, {"max_iterations": -1}):
        with pytest.raises(MasatError):
            masat.solve(graph, **wrong)


def test_a_result_with_its_certificate_can_be_saved(tmp_path):
    result = masat.solve(noisy(0.05), certify=True, root=5)
    result.save(tmp_path / "r.npz")
    again = masat.Result.load(tmp_path / "r.npz")
    assert again.certificate.to_dict() == result.certificate.to_dict()
    assert (again.init, again.init_seconds) == (result.init, result.init_seconds)
    assert again.gauge.tolist() == [5]
    assert again.graph.gauge.tolist() == [5]


def test_nothing_private_is_listed():
    assert not [name for name in dir(masat) if name.startswith("_") and name != "__version__"]
    assert masat.__version__.count(".") == 2
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        masat.nothing  # noqa: B018


SEARCHING = """
import sys
from masat.cli import progress

class Telling(progress.Stages):
    def __call__(self, stage):
        if "searching" in stage.what:
            print("searching", file=sys.stderr, flush=True)

progress.Stages = Telling
sys.argv = ["masat", "solve", "hard.g2o", "-o", "map.g2o", "--json"]
from masat.cli import main
main()
"""


def test_ctrl_c_on_the_command_line_writes_the_best_so_far(tmp_path):
    masat.write(perturb(sphere(1500, seed=1), [0.45, 0.45], seed=1), tmp_path / "hard.g2o")
    process = subprocess.Popen(
        [sys.executable, "-c", SEARCHING],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    for line in process.stderr:
        if "searching" in line:
            break
    process.send_signal(signal.SIGINT)
    out, _ = process.communicate(timeout=120)
    assert process.returncode == 1
    said = json.loads(out)
    assert said["reason"] == "interrupted"
    assert said["chi2"] <= said["initial_chi2"]
    assert (tmp_path / "map.g2o").exists()
