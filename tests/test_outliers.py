"""Maps that cannot be right are told, and not searched; clean graphs are never suspected."""

import json
import subprocess
import sys
import warnings
from dataclasses import replace

import numpy as np
import pytest
from random_graphs import random_graph
from test_false_closures import world
from test_real_files import FILES

import masat
from masat import PoseGraph, StopReason, outliers
from masat.chain import odometry_edges
from masat.neighbors import neighbor_scale
from masat.optimality import best
from masat.optimizers import Result
from masat.outliers import Suspicion, cannot_be_right, describe_outliers, outlying_edges
from masat.worlds import add_false_closures, manhattan, perturb
from masat.worlds.false_closures import KINDS

pytestmark = pytest.mark.filterwarnings("ignore::masat.MasatWarning")

CLEAN = [name for name in FILES if name[:3] in ("2d/", "3d/") and "groundtruth" not in name]


def bare(graph, factor=1.0):
    """The graph without poses, its information times a factor."""
    return PoseGraph.from_arrays(graph.edges, graph.measurements, factor * graph.information)


def said_of(result):
    return [note for note in result.graph.notes if isinstance(note, Suspicion)]


def spoiled(dimension, kind, fraction, seed=0):
    """A world with false loop closures, or with a single one if the fraction is zero."""
    clean = masat.solve(world(dimension)).graph
    closures = np.count_nonzero(~odometry_edges(clean))
    return add_false_closures(clean, kind, fraction or 1 / (closures + 1), seed=seed)


def test_chi2_without_an_edge_by_hand():
    """Of the measurements 0, 0 and 3 m the mean is 1 m; without the last chi2 falls from 6 to 0."""
    measurements = [(0, 0, 0), (0, 0, 0), (3, 0, 0)]
    graph = PoseGraph.from_arrays([(0, 1)] * 3, measurements, poses=[(0, 0, 0), (1, 0, 0)])
    loss, is_checked = outliers._chi2_without(graph)
    assert np.allclose(loss, [1.5, 1.5, 6])
    assert is_checked.all()


@pytest.mark.parametrize("dimension", [2, 3])
def test_chi2_without_an_edge_is_that_of_a_solve_without_it(dimension, monkeypatch):
    monkeypatch.setattr(outliers, "_LEAST_REDUNDANCY", 1e-9)
    noisy = random_graph(dimension, 20, 25, seed=3, noise=1e-4)
    graph = masat.optimize(noisy, relative_tolerance=1e-12).graph
    loss, _ = outliers._chi2_without(graph)
    for k in (0, 7, 30):
        without = masat.optimize(graph.without_edges([k]), relative_tolerance=1e-12)
        assert np.isclose(loss[k], graph.chi2 - without.chi2, rtol=0.02)


def test_an_edge_that_nothing_checks_is_not_suspected():
    chain = PoseGraph.from_arrays([(0, 1), (1, 2)], [(1, 0, 0)] * 2, poses=np.zeros((3, 3)))
    _, is_checked = outliers._chi2_without(chain)
    assert not is_checked.any()
    assert describe_outliers(PoseGraph.from_arrays([], np.zeros((0, 3)), ids=[0])) == ()


def test_neighbors_do_not_look_at_poses_and_scale_with_the_information():
    graph = world(2)
    scale = neighbor_scale(graph)
    assert 0.05 < scale < 1
    assert neighbor_scale(bare(graph)) == scale
    assert np.isclose(neighbor_scale(bare(graph, 25.0)), 25 * scale)
    assert neighbor_scale(graph.without_edges(~odometry_edges(graph))) is None
    wrong, _ = spoiled(2, "alias", 0.5)
    assert neighbor_scale(wrong) < 2 * scale
    # Each measurement twice: copies agree, which tells nothing.
    copied = graph.with_edges(graph.edges, graph.measurements, graph.information)
    assert neighbor_scale(copied) > scale / 4


def test_neighbors_of_reversed_edges_are_the_same():
    graph = world(3)
    turned = ~odometry_edges(graph) & (np.arange(len(graph.edges)) % 2 == 0)
    edges, z = graph.edges.copy(), graph.measurements.copy()
    edges[turned], z[turned] = edges[turned, ::-1], masat.lie.inverse(z[turned])
    other = PoseGraph.from_arrays(edges, z, graph.information)
    assert np.isclose(neighbor_scale(other), neighbor_scale(graph), rtol=0.1)


@pytest.mark.parametrize("name", CLEAN)
def test_clean_graphs_are_not_suspected(name, data_dir):
    result = masat.solve(masat.read(data_dir / name))
    assert said_of(result) == []


@pytest.mark.parametrize("indefinite", ["identity", "nearest"])
def test_a_graph_with_repaired_information_is_not_suspected(indefinite, data_dir):
    graph = masat.read(data_dir / "3d/cubicle.g2o", indefinite=indefinite)
    assert said_of(masat.solve(graph)) == []


@pytest.mark.parametrize("factor", [1 / 50, 1, 25, 1000])
@pytest.mark.parametrize("sigma", [0.05, 0.3])
def test_noise_is_not_suspected_whatever_the_information(factor, sigma):
    graph = perturb(manhattan(400, 700, extent=14, seed=2), [sigma] * 3, seed=2)
    result = masat.solve(bare(graph, factor))
    if factor < 100:
        assert said_of(result) == []
    else:
        (said,) = said_of(result)  # reduced chi2 is 1000
        assert "or the information is too large" in said
    assert not cannot_be_right(result.graph, result.chi2)


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("fraction", [0, 0.1, 0.5])
def test_false_closures_are_told_in_one_sentence(dimension, kind, fraction):
    graph, is_false = spoiled(dimension, kind, fraction)
    with pytest.warns(masat.MasatWarning, match="contradict the map far beyond"):
        result = masat.solve(bare(graph))
    (said,) = said_of(result)
    assert "robust=True" in said
    assert "--robust" in said
    assert "\n" not in said
    if fraction == 0:
        a, b = graph.edges[is_false][0]
        assert f"{a} -> {b} (" in said


@pytest.mark.parametrize("factor", [1 / 50, 25])
@pytest.mark.parametrize("kind", KINDS)
def test_false_closures_are_told_at_information_of_another_scale(factor, kind):
    graph, _ = spoiled(2, kind, 0.3)
    assert said_of(masat.solve(bare(graph, factor)))


def test_labeled_graphs_are_told(data_dir):
    for path in sorted((data_dir / "false_closures").glob("*_alpha_*.g2o.gz")):
        (said,) = said_of(masat.solve(masat.read(path)))
        assert "cannot be right" in said
    for path in sorted((data_dir / "false_closures").glob("*_true_closures.g2o.gz")):
        assert said_of(masat.solve(masat.read(path))) == []


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("dimension", [2, 3])
def test_there_is_no_search_where_the_map_cannot_be_right(dimension, kind):
    graph, _ = spoiled(dimension, kind, 0.3)
    stages = []
    masat.solve(bare(graph), report_stage=stages.append)
    assert not any("searching" in stage.what or "lifting" in stage.what for stage in stages)
    (warning,) = [stage.what for stage in stages if stage.warning]
    assert "cannot be right" in warning


@pytest.mark.parametrize("factor", [1, 100])
def test_a_local_minimum_is_searched_whatever_the_information(factor):
    graph = perturb(manhattan(400, 700, extent=14, seed=2), [0.35] * 3, seed=11)
    stages = []
    result = masat.solve(bare(graph, factor), report_stage=stages.append)
    assert any("searching" in stage.what for stage in stages)
    assert np.isclose(result.chi2, factor * masat.solve(bare(graph)).chi2, rtol=1e-6)


@pytest.mark.slow
def test_hard_minima_end_no_higher_than_the_best_known(data_dir):
    for path in sorted((data_dir / "hard_minima").glob("*_best.g2o.gz")):
        best_known = masat.read(path).chi2
        graph = masat.read(path.with_name(path.name.replace("_best", "")))
        result = masat.solve(graph)
        assert result.chi2 < best_known * 1.05
        assert not cannot_be_right(graph, result.chi2)


def test_a_minimum_without_a_search_may_be_a_local_one():
    graph = perturb(manhattan(400, 700, extent=14, seed=2), [0.1] * 3, seed=2)
    result = masat.solve(bare(graph), init="odometry")
    assert result.chi2 > 5 * masat.solve(bare(graph)).chi2
    (said,) = said_of(result)
    assert "init='auto'" in said


def test_the_outliers_are_the_false_edges_first():
    graph, is_false = spoiled(2, "random", 0.005, seed=1)
    solved = masat.optimize(graph).graph
    far = outlying_edges(solved)
    assert set(far[: is_false.sum()]) == set(np.flatnonzero(is_false))


def test_the_iterations_are_limited_where_they_are_expensive(monkeypatch):
    graph, _ = spoiled(3, "random", 0.5)
    monkeypatch.setattr("masat.solver._MAX_OPERATIONS", 0.0)
    monkeypatch.setattr(best, "_EXPENSIVE", 0.0)
    stages = []
    result = masat.solve(bare(graph), report_stage=stages.append)
    assert result.reason is StopReason.MAX_ITERATIONS
    assert result.message.startswith("stopped after 0 iterations: the map cannot be right")
    assert not any("optimizing" in stage.what for stage in stages)
    assert len(said_of(result)) == 1
    # A graph that is right is optimized in full, however expensive it is.
    clean = masat.solve(bare(world(3)))
    assert clean.converged
    assert said_of(clean) == []
    assert not any("stopped" in r.message for r in [clean])
    # And so is this one from another initial guess.
    assert masat.solve(bare(graph), init="chordal").iterations > 3


def test_a_robust_solve_and_a_loss_say_nothing_of_what_they_left_out():
    graph, _ = spoiled(2, "random", 0.2)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert said_of(masat.solve(bare(graph), robust=True)) == []
        assert said_of(masat.solve(bare(graph), init="odometry", loss="gnc_tls")) == []


def test_a_certificate_says_what_it_does_not_mean(tmp_path):
    graph, _ = spoiled(2, "local", 0)
    result = masat.solve(bare(graph), certify=True)
    proof = result.certificate
    assert proof.certified
    assert proof.message.startswith("globally optimal")
    assert "the map may be wrong all the same" in proof.message
    assert "contradict the map" in proof.caveat
    assert "local minimum" not in proof.caveat  # that is ruled out
    assert proof.to_dict()["caveat"] == proof.caveat
    assert proof.caveat in proof._repr_html_().replace("&gt;", ">").replace("&#x27;", "'")
    result.save(tmp_path / "result.npz")
    assert Result.load(tmp_path / "result.npz").certificate.caveat == proof.caveat
    clean = masat.solve(bare(world(2)), certify=True).certificate
    assert clean.certified
    assert clean.caveat is None
    assert "all the same" not in clean.message


def test_the_command_line_tells(tmp_path):
    graph, _ = spoiled(2, "local", 0)
    masat.write(bare(graph), tmp_path / "graph.g2o")

    def run(*arguments):
        command = [sys.executable, "-m", "masat", *arguments]
        return subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)

    solved = run("solve", "graph.g2o", "-o", "map.g2o")
    assert solved.stderr.count("contradict the map far beyond") == 1
    assert "the map may be wrong all the same" in solved.stdout
    assert "caution" in run("certify", "map.g2o").stdout
    assert "contradict" in json.loads(run("certify", "map.g2o", "--json").stdout)["caveat"]


def test_a_note_of_the_input_stays():
    graph, _ = spoiled(2, "random", 0.3)
    noted = replace(bare(graph), notes=("from a test",))
    result = masat.solve(noted)
    assert result.graph.notes[0] == "from a test"
    assert len(result.graph.notes) == 2
    # Solved again, the note is that of the new map alone.
    assert len(masat.solve(result.graph).graph.notes) == 2


def test_a_suspicion_is_a_sentence_that_survives_pickling():
    import pickle

    said = Suspicion("an edge contradicts the map", ["it is false", "it is not"])
    assert said == "an edge contradicts the map; probably it is false, or it is not"
    again = pickle.loads(pickle.dumps(said))
    assert again == said
    assert again.contradiction == "an edge contradicts the map"
