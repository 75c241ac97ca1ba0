"""The parts of a robust decision: predictions, checks, scales, slips, unconnected parts."""

import numpy as np
import pytest

import masat
from masat import PoseGraph, lie
from masat.chain import odometry_edges
from masat.residuals import chi2_per_edge
from masat.robust import decide
from masat.robust.closures import Closures
from masat.robust.prediction import predict, predict_by_odometry
from masat.robust.redundancy import redundancy
from masat.robust.whole import fit_of_all, odometry_allows
from masat.worlds import manhattan, perturb, sphere
from masat.worlds.false_closures import add_false_closures, normalized


def clean(world=manhattan, nodes=400):
    graph = perturb(world(nodes, seed=1), [0.03] * (3 if world is manhattan else 6), seed=1)
    return normalized(masat.solve(graph).graph)


def random_graph(dimension, nodes=40, closures=30, seed=0):
    """Odometry in both directions, closures and information at random."""
    rng = np.random.default_rng(seed)
    dof = lie.DOF[dimension]
    far = [sorted(rng.choice(nodes, 2, replace=False)) for _ in range(closures)]
    edges = [(k, k + 1) for k in range(nodes - 1)] + [pair for pair in far if pair[1] - pair[0] > 1]
    edges = [edge if rng.random() < 0.5 else edge[::-1] for edge in edges]
    steps = rng.normal(size=(len(edges), dof)) * 0.3
    factors = rng.normal(size=(len(edges), dof, dof))
    information = factors @ factors.swapaxes(1, 2) + np.eye(dof)
    return PoseGraph.from_arrays(edges, lie.retract(lie.identity(dimension), steps), information)


@pytest.mark.parametrize("dimension", [2, 3])
def test_predictions_along_odometry_are_those_of_its_system(dimension):
    closures = Closures(random_graph(dimension))
    trusted = masat.initialize(closures.graph.without_edges(~closures.trusted), "odometry")
    every = np.arange(len(closures))
    expected = predict(closures, trusted, every)
    found = predict_by_odometry(closures, trusted, every)
    assert np.allclose(found.distance, expected.distance, rtol=1e-10)
    assert np.allclose(found.log_ratio, expected.log_ratio, rtol=1e-10)


@pytest.mark.parametrize("world", [manhattan, sphere])
def test_what_is_left_out_is_as_far_as_the_others_predict(world):
    graph = clean(world, 100)
    checks = redundancy(graph)
    assert np.allclose(checks.chi2, graph.chi2_per_edge)
    # The expected chi2 of a map is its number of redundant measurements.
    free = graph.dof * (len(graph.edges) - len(graph) + 1)
    assert np.isclose(checks.redundancy_numbers.sum(), free, rtol=1e-6)
    closures = Closures(graph)
    one = len(closures) // 2
    kept = np.arange(len(closures)) != one
    rest = masat.optimize(closures.graph_with(kept, graph.poses)).graph
    distance = predict(closures, rest, np.array([one])).distance[0]
    assert np.isclose(checks.left_out[closures.edges[one]], distance, rtol=0.05)


def test_a_chain_has_nothing_to_check():
    graph = masat.initialize(PoseGraph.from_arrays([(0, 1), (1, 2)], [(1, 0, 0)] * 2), "odometry")
    checks = redundancy(graph)
    assert np.allclose(checks.redundancy_numbers, 0, atol=1e-9)
    assert checks.scale(np.ones(2, bool)) is None


@pytest.mark.parametrize("factors", [(1, 1), (9, 9), (0.04, 0.04), (1, 9), (4, 1)])
def test_scales_of_both_kinds_of_edges_are_found(factors):
    graph = clean(nodes=1500)
    trusted = odometry_edges(graph)
    divided = np.where(trusted, *factors)[:, None, None]
    graph = PoseGraph.from_arrays(graph.edges, graph.measurements, graph.information * divided)
    checks = redundancy(masat.solve(graph).graph)
    # Where they differ, the weights of the map are wrong, and the first estimate is halfway.
    found = np.array(checks.scales(trusted)) / factors
    assert (found < 2).all()
    assert (found > 0.5).all()
    if factors[0] == factors[1]:
        assert np.allclose(found, 1, atol=0.1)


@pytest.mark.parametrize("kind", ["random", "local", "grouped", "alias"])
@pytest.mark.parametrize("fraction", [0.02, 0.5])
def test_only_a_clean_graph_fits_as_a_whole(kind, fraction):
    graph = clean()
    fit = fit_of_all(Closures(graph))
    assert fit is not None
    assert fit.kept.all()
    spoiled, _ = add_false_closures(graph, kind, fraction, seed=1)
    closures = Closures(spoiled)
    assert odometry_allows(closures) is None or fit_of_all(closures) is None


def test_an_outlier_of_a_clean_graph_is_rejected():
    graph = clean()
    edge = int(np.flatnonzero(~odometry_edges(graph))[20])
    measured = graph.measurements.copy()
    sigma = np.sqrt(np.linalg.inv(graph.information[edge]).diagonal())
    measured[edge] = lie.retract(measured[edge], sigma * [12, 0, 0])
    decision = decide(PoseGraph.from_arrays(graph.edges, measured, graph.information))
    assert np.flatnonzero(~decision.kept).tolist() == [edge]


@pytest.mark.parametrize("world", [manhattan, sphere])
@pytest.mark.parametrize("step", [100, 200, 300])
def test_a_slipped_wheel_is_released(world, step):
    graph = clean(world, 400)
    trusted = odometry_edges(graph)
    edge = int(np.flatnonzero(trusted)[step])
    measured = graph.measurements.copy()
    slip = (3.0, -2.0, 1.0) if world is manhattan else (3.0, -2.0, 1.0, 0.0, 0.0, 0.6, 0.8)
    measured[edge] = lie.compose(measured[edge], slip)
    slipped = PoseGraph.from_arrays(graph.edges, measured, graph.information)
    decision = decide(slipped)
    assert len(decision.released) == 1
    # Nothing tells it from the steps that the same closures span.
    assert abs(int(decision.released[0]) - edge) <= 10
    row = decision.closures[decision.closures["edge"] == decision.released[0]][0]
    assert "all closures across it" in row["reason"]
    closures = ~trusted
    assert decision.kept[closures].mean() > 0.98
    true = graph.without_edges(np.array([edge]))
    chi2 = chi2_per_edge(true, masat.solve(slipped, robust=True).poses).sum()
    assert chi2 < 1.2 * masat.solve(true).chi2 or decision.released[0] != edge


def test_parts_are_joined_by_the_closures_that_agree():
    graph = clean()
    spoiled, false = add_false_closures(graph, "random", 0.4, seed=3)
    step = np.flatnonzero(odometry_edges(spoiled))[200]
    two = spoiled.without_edges(np.array([step]))
    false = np.delete(false, step)
    decision = decide(two)
    assert not (decision.kept & false).any()
    assert (decision.kept | false).mean() > 0.98
    reasons = decision.closures["reason"].tolist()
    assert sum("joins parts" in reason for reason in reasons) == 1


def test_a_rival_is_told():
    # Two closures of one place exclude each other, and nothing tells which is true.
    edges = [(k, k + 1) for k in range(20)] + [(0, 20), (0, 20)]
    measured = [(1, 0, 0)] * 20 + [(21, 0, 0), (19, 0, 0)]
    graph = PoseGraph.from_arrays(edges, measured, np.diag([100.0, 100, 400]))
    decision = decide(graph)
    assert decision.closures["kept"].sum() <= 1
    assert masat.solve(graph, robust=True).decision.to_dict()["closures"] == 2


def test_fixed_nodes_that_contradict_odometry_are_told():
    edges = [(k, k + 1) for k in range(29)] + [(0, 3), (20, 23), (5, 8)]
    measured = [(1, 0, 0)] * 29 + [(3, 0, 0), (3, 0, 0), (9, 0, 0)]
    poses = np.zeros((30, 3))
    poses[29, 0] = 500.0
    graph = PoseGraph.from_arrays(
        edges, measured, np.diag([100.0, 100, 400]), ids=range(30), poses=poses, fixed=[0, 29]
    )
    with pytest.warns(masat.MasatWarning, match="contradict the fixed nodes"):
        result = masat.solve(graph, robust=True)
    assert "contradict the fixed nodes" in result.graph.notes[-1]


@pytest.mark.parametrize("factor", [10.0, 30.0])
@pytest.mark.parametrize(("kind", "fraction"), [("random", 0.1), ("alias", 0.3)])
def test_information_that_is_too_large_altogether_is_recognized(kind, fraction, factor):
    spoiled, false = add_false_closures(clean(nodes=150), kind, fraction, seed=0)
    graph = PoseGraph.from_arrays(spoiled.edges, spoiled.measurements, spoiled.information * factor)
    decision = decide(graph)
    assert not (decision.kept & false).any()
    assert (decision.kept | false).mean() > 0.97
    assert np.allclose(decision.scales, factor, rtol=0.7)


def test_parts_may_alternate_in_their_ids():
    # Two robots, whose ids are even and odd, with true links and a run of false ones.
    a, b = np.arange(0, 80, 2), np.arange(1, 81, 2)
    chain = [(int(k), int(k) + 2) for k in np.concatenate([a[:-1], b[:-1]])]
    true = [(int(a[k]), int(b[k])) for k in range(0, 36, 2)]
    wrong = [(int(a[k]), int(b[k + 20])) for k in range(12)]
    rng = np.random.default_rng(0)
    noise = rng.normal(0, 0.05, (len(chain) + len(true) + len(wrong), 3)) * [1, 1, 0.2]
    exact = [(1, 0, 0)] * len(chain) + [(0, 2, 0)] * len(true) + [(0, 2, 0)] * len(wrong)
    graph = PoseGraph.from_arrays(chain + true + wrong, exact + noise, np.diag([400.0, 400, 1e4]))
    trusted = np.arange(len(graph.edges)) < len(chain)
    decision = decide(graph, trusted)
    ends = len(chain) + len(true)
    assert decision.kept[:ends].all()
    assert not decision.kept[ends:].any()


def test_an_interrupt_leaves_a_whole_map(monkeypatch):
    from masat.progress import Progress
    from masat.robust.growth import Growth

    spoiled, _ = add_false_closures(clean(), "random", 0.5, seed=0)
    full = Growth._set_map
    calls = 0

    def interrupted(self, *args):
        nonlocal calls
        calls += 1
        if calls > 3:
            raise KeyboardInterrupt
        full(self, *args)

    monkeypatch.setattr(Growth, "_set_map", interrupted)
    decision = decide(spoiled, progress=Progress(catch_interrupts=True))
    kept = spoiled.without_edges(~decision.kept).with_poses(decision.poses)
    assert decision.closures["kept"].sum() > 0
    assert (kept.chi2_per_edge[~odometry_edges(kept)] < 26).all()
    assert "not judged: the time was over" in decision.closures["reason"]
