"""Which loop closures a robust solve believes, against labelled and spoiled graphs."""

import json

import numpy as np
import pytest

import masat
from masat import OptimizationError, PoseGraph
from masat.chain import odometry_edges
from masat.quantiles import GATE
from masat.residuals import chi2_per_edge
from masat.robust import decide
from masat.robust.closures import Closures
from masat.robust.objective import cost, price
from masat.robust.prediction import agreement, predict
from masat.worlds import city, manhattan, perturb, sphere
from masat.worlds.false_closures import add_false_closures


def clean(world=manhattan, sigma=0.03, nodes=400):
    graph = perturb(world(nodes, seed=1), [sigma] * (3 if world is manhattan else 6), seed=1)
    return masat.solve(graph).graph


def line(*closures, **more):
    """Five nodes a meter apart, and closures (a, b, x)."""
    edges = [(0, 1), (1, 2), (2, 3), (3, 4), *((a, b) for a, b, _ in closures)]
    measured = [(1, 0, 0)] * 4 + [(x, 0, 0) for _, _, x in closures]
    return PoseGraph.from_arrays(edges, measured, np.diag([100.0, 100, 400]), **more)


@pytest.mark.parametrize("kind", ["random", "local", "grouped", "alias"])
@pytest.mark.parametrize("world", [manhattan, sphere])
def test_false_closures_are_rejected_and_true_ones_kept(kind, world):
    graph = clean(world)
    spoiled, false = add_false_closures(graph, kind, 0.5, seed=3)
    result = masat.solve(spoiled, robust=True)
    kept = result.kept
    assert not (kept & false).any()
    assert (kept | false).mean() > 0.99
    plain = masat.solve(graph.without_edges(~kept[: len(graph.edges)]))
    assert np.isclose(result.chi2, plain.chi2, rtol=1e-6)


@pytest.mark.parametrize("fraction", [0.2, 0.4])
def test_a_false_group_that_was_believed_early_is_found_by_the_rest(fraction):
    graph = perturb(city(1000, seed=0), (0.1, 0.1, 0.05), seed=0)
    spoiled, false = add_false_closures(graph, "alias", fraction, seed=0)
    kept = decide(spoiled).kept
    assert not (kept & false).any()
    assert (kept | false).mean() > 0.99


KITTI = ["00_alpha_0.00", "00_alpha_0.25", "00_alpha_0.50", "00_alpha_1.00", "05_alpha_0.00",
         "05_alpha_0.50", "07_alpha_0.00", "07_alpha_0.50"]  # fmt: skip


# Of 07 next to no closure is kept, which a note says.
@pytest.mark.filterwarnings("ignore:only 1 of")
@pytest.mark.parametrize("name", KITTI)
def test_closures_of_a_place_recognizer(name, data_dir):
    folder = data_dir / "false_closures"
    graph = masat.read(folder / f"kitti_{name}.g2o.gz")
    listed = np.loadtxt(folder / f"kitti_{name}_true.txt", np.int64, ndmin=2)[:, :2]
    true = {frozenset(pair) for pair in listed.tolist()}
    is_true = np.array([frozenset(pair) in true for pair in graph.edges.tolist()])
    result = masat.solve(graph, robust=True)
    table = result.closures
    assert is_true[table["edge"][table["kept"]]].all()
    assert table["kept"].sum() >= 0.98 * is_true[table["edge"]].sum()
    # No worse by its own objective than the truth.
    closures = Closures(graph)
    truth = graph.without_edges(~closures.kept_edges(is_true[closures.edges]))
    poses = masat.solve(truth).poses
    of_truth = cost(closures, is_true[closures.edges], chi2_per_edge(graph, poses))
    assert result.decision.cost <= of_truth * (1 + 1e-3)


def test_a_clean_graph_keeps_its_closures():
    graph = clean()
    result = masat.solve(graph, robust=True)
    assert result.kept.all()
    assert np.isclose(result.chi2, graph.chi2, rtol=1e-6)
    assert result.decision.used == (1, 1)
    assert np.allclose(result.decision.scales, 1, atol=0.2)


@pytest.mark.parametrize("factor", [25.0, 4.0, 1 / 50])
def test_information_that_is_off_by_a_factor_is_recognized(factor):
    spoiled, false = add_false_closures(clean(), "alias", 0.25, seed=3)
    information = spoiled.information.copy()
    information[~odometry_edges(spoiled)] *= factor
    graph = PoseGraph.from_arrays(spoiled.edges, spoiled.measurements, information)
    decision = decide(graph)
    assert not (decision.kept & false).any()
    assert (decision.kept | false).mean() > 0.9
    if decision.used != (1, 1):
        assert factor / 2 < decision.scales.closures < factor * 2
        assert 0.5 < decision.scales.trusted < 2


def test_the_table_tells_why():
    graph = line((0, 2, 2.0), (1, 3, 2.05), (0, 4, 9.0))
    decision = decide(graph)
    table = decision.closures
    assert table["kept"].tolist() == [True, True, False]
    assert table["reason"].tolist() == ["kept", "kept", "contradicts the trusted edges"]
    assert table[["from", "to"]].tolist() == [(0, 2), (1, 3), (0, 4)]
    assert decision.kept.tolist() == [True] * 6 + [False]
    assert np.isnan(table["distance"][0])
    # (9 - 4)^2 over the variances of four edges and its own, roughly.
    assert table["distance"][2] > GATE[3]
    assert decision.to_dict()["rejected"][0]["to"] == 4


def test_a_prediction_is_that_of_the_chain():
    closures = Closures(line((0, 4, 4.5)))
    poses = masat.initialize(line(), "odometry").poses
    found = predict(closures, line().with_poses(poses), np.array([0]))
    # x of node 4 has the variance 4 / 100 in a straight line, the closure 1 / 100.
    assert np.isclose(found.distance[0], 0.5**2 / (5 / 100))


def test_closures_of_one_place_support_each_other():
    closures = Closures(line((0, 3, 3.0), (1, 4, 3.0), (0, 4, 9.0)))
    poses = masat.initialize(line(), "odometry").poses
    agree = {
        frozenset(pair): bool(value < GATE[3])
        for pair, value in zip(
            closures.pairs.tolist(), agreement(closures, poses, closures.pairs), strict=True
        )
    }
    assert agree == {
        frozenset((0, 1)): True,
        frozenset((0, 2)): False,
        frozenset((1, 2)): False,
    }
    assert len(set(closures.clusters.tolist())) == 1


def test_the_price_of_a_run_grows_slower_than_its_closures():
    closures = Closures(line((0, 2, 2.0), (1, 3, 2.0), (2, 4, 2.0)))
    assert price(closures, np.array([True, False, False])) == GATE[3]
    assert price(closures, np.array([True, True, True])) == GATE[3] + 2 * 3 * 2
    chi2 = np.arange(7.0)
    assert cost(closures, np.array([True, False, True]), chi2) == 0 + 1 + 2 + 3 + 4 + 6 + GATE[3]


def test_without_closures_there_is_nothing_to_decide():
    result = masat.solve(line(), robust=True)
    assert result.kept.all()
    assert len(result.closures) == 0


def test_what_cannot_be_judged_is_refused():
    graph = line((0, 2, 2.0))
    far = PoseGraph.from_arrays([(0, 5), (5, 9)], [(1, 0, 0)] * 2, ids=[0, 2, 5, 7, 9])
    with pytest.raises(OptimizationError, match="no edge is trusted"):
        decide(far)
    with pytest.raises(OptimizationError, match="a boolean for each of the 5 edges"):
        decide(graph, [True, False])
    with pytest.raises(OptimizationError, match="exclude each other"):
        masat.solve(graph, robust=True, loss="cauchy")


def test_every_closure_may_be_false():
    graph = line((0, 3, 9.0), (1, 4, -9.0), (0, 2, 7.0))
    result = masat.solve(graph, robust=True)
    assert not result.closures["kept"].any()
    assert result.chi2 < 1e-12


def test_the_same_decision_each_time_and_saved(tmp_path):
    spoiled, _ = add_false_closures(clean(), "random", 0.5, seed=4)
    one, two = (masat.solve(spoiled, robust=True, threads=n) for n in (1, 2))
    assert np.array_equal(one.kept, two.kept)
    assert np.array_equal(one.poses, two.poses)
    one.save(tmp_path / "r.npz")
    again = masat.Result.load(tmp_path / "r.npz")
    assert np.array_equal(again.kept, one.kept)
    assert again.closures["reason"].tolist() == one.closures["reason"].tolist()
    assert again.decision.cost == one.decision.cost


def test_the_command_line_writes_both_parts(run, tmp_path):
    spoiled, false = add_false_closures(clean(), "alias", 0.3, seed=5)
    masat.write(spoiled, tmp_path / "g.g2o")
    out, rest = tmp_path / "map.g2o", tmp_path / "rejected.g2o"

    code, text, _ = run("solve", tmp_path / "g.g2o", "--robust", "-o", out, "--rejected", rest)
    assert code == 0
    assert "loop closures" in text
    assert "contradicts" in text
    assert len(masat.read(out).edges) == (~false).sum()
    assert len(masat.read(rest).edges) == false.sum()
    code, text, _ = run("solve", tmp_path / "g.g2o", "--robust", "--json")
    assert json.loads(text)["decision"]["closures"] == int((~odometry_edges(spoiled)).sum())
    assert run("solve", tmp_path / "g.g2o", "--rejected", rest)[0] == 2
