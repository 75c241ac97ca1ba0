"""Maps that grow and judge their loop closures, and their reviews."""

import subprocess
import sys

import numpy as np
import pytest
from random_graphs import random_graph
from test_online import SQUARE, at_linearization, feed

import masat
from masat import OnlineMap, OptimizationError, worlds
from masat.online import review, schedule
from masat.online.stream import replay
from masat.robust.prediction import log_volume
from masat.study.scores import score

DIFFERENT_PLACE = (3.0, 2.0, 1.0)


def circles(world, count, *, spoil=()):
    """Drive circles of eight steps; each pose sees the one above which it is."""
    numbers = {}
    for k in range(count):
        world.add_pose(k)
        if k > 0:
            world.add_edges((k - 1, k), (1, 0, np.pi / 4), 100 * np.eye(3))
        if k >= 8:
            z = DIFFERENT_PLACE if k in spoil else (0, 0, 0)
            numbers[k] = int(world.add_edges((k - 8, k), z, 100 * np.eye(3))[0])
        world.update()
    return numbers


def drifted():
    """A map after 60 steps of bad odometry, with 28 false closures, and the information of all."""
    world = OnlineMap(2, robust=True)
    loose = np.diag([8.0, 8.0, 800.0])
    for k in range(61):
        world.add_pose(k)
        if k > 0:
            world.add_edges((k - 1, k), (1, 0, np.pi / 30), loose)
        world.update()
    # The more false ones there are, the more likely one fits by chance.
    for k in range(2, 30):
        world.add_edges((k, k + 2), (30, 30, 2), loose)
    world.update()
    return world, loose


def spoiled(world, kind, fraction=0.5, *, seed=0):
    clean = masat.optimize(worlds.perturb(world, _sigmas(world), seed=seed))
    clean = worlds.normalized(clean.graph)
    graph, is_false = worlds.add_false_closures(clean, kind, fraction, seed=seed)
    return clean, graph, is_false


def _sigmas(world):
    return (0.05, 0.05, 0.02) if world.dimension == 2 else (0.05, 0.02)


@pytest.mark.parametrize("dimension", [2, 3])
def test_predictions_are_those_of_relative_covariances(dimension):
    graph = random_graph(dimension, 12, 30, seed=1)
    world = OnlineMap(dimension, tolerance=0)
    feed(world, graph)
    others = random_graph(dimension, 12, 30, seed=2)
    ends = np.ascontiguousarray(others.edge_indices.astype(np.int32))
    at = world._core.find_all(others.edges.ravel()).reshape(-1, 2).astype(np.int32)
    assert ends.shape == at.shape
    distance, log_determinant = world._core.predict(
        np.ascontiguousarray(at), others.measurements, others.information
    )
    own = at_linearization(world)
    poses = own.poses[own.index(others.edges.ravel())].reshape(len(at), 2, -1)
    covariance = masat.relative_covariances(own, others.edges)
    for k, (a, b) in enumerate(poses):
        e = masat.lie.local(others.measurements[k : k + 1], masat.lie.between(a[None], b[None]))
        # By finite differences: the derivative by a step at the end of the edge.
        step = 1e-6
        jacobian = np.zeros((own.dof, own.dof))
        for c in range(own.dof):
            moved = []
            for sign in (1, -1):
                tangent = np.zeros((1, own.dof))
                tangent[0, c] = sign * step
                there = masat.lie.retract(masat.lie.between(a[None], b[None]), tangent)
                moved.append(masat.lie.local(others.measurements[k : k + 1], there)[0])
            jacobian[:, c] = (moved[0] - moved[1]) / (2 * step)
        total = jacobian @ covariance[k] @ jacobian.T + np.linalg.inv(others.information[k])
        assert distance[k] == pytest.approx(float(e[0] @ np.linalg.solve(total, e[0])), rel=1e-5)
        expected = np.linalg.slogdet(2 * np.pi * total)[1]
        assert log_determinant[k] == pytest.approx(expected, rel=1e-5, abs=1e-5)


def test_what_contradicts_the_map_is_left_out():
    plain, world = OnlineMap(2), OnlineMap(2, robust=True)
    numbers = circles(world, 40, spoil=(20, 33))
    circles(plain, 40, spoil=())
    assert world.rejected.tolist() == [numbers[20], numbers[33]]
    table = world.closures
    assert len(table) == 32
    assert table["kept"].sum() == 30
    assert set(table["reason"][~table["kept"]]) == {"contradicts the map"}
    assert (table["distance"][~table["kept"]] > 100).all()
    assert table[["from", "to"]][12].tolist() == (12, 20)
    np.testing.assert_allclose(world.poses, plain.poses, atol=1e-6)
    assert len(world.graph().edges) == 39 + 30
    assert world.chi2 == pytest.approx(0, abs=1e-9)


def test_trusted_edges_are_not_judged():
    world = OnlineMap(2, robust=True)
    circles(world, 20)
    world.add_edges((3, 14), DIFFERENT_PLACE, trusted=True)
    world.update()
    assert len(world.rejected) == 0
    assert world.chi2 > 1


def test_odometry_can_be_doubted_and_what_joins_two_parts_waits():
    world = OnlineMap(2, robust=True)
    circles(world, 20)
    for k in range(100, 104):
        world.add_pose(k)
        if k > 100:
            world.add_edges((k - 1, k), (1, 0, 0))
    number = world.add_edges((5, 101), (1, 0, 0))
    world.update()
    assert world.rejected.tolist() == number.tolist()
    assert "nothing trusted connects" in world.closures["reason"][-1]
    assert np.isnan(world.closures["distance"][-1])


def test_two_closures_that_agree_convince_where_one_alone_does_not():
    world, loose = drifted()
    false = world.rejected.tolist()
    assert len(false) == 28
    first = world.add_edges((0, 60), (0.8, -0.6, 0.1), loose)
    world.update()
    assert world.rejected.tolist() == [*false, *first.tolist()]
    assert world.closures["reason"][-1].startswith("undecided")
    world.add_edges((1, 59), (-1.2, -0.5, -0.3), loose)
    world.update()
    assert world.rejected.tolist() == false


def test_closures_that_are_left_out_can_be_removed():
    world = OnlineMap(2, robust=True)
    numbers = circles(world, 30, spoil=(20,))
    world.remove_edges([numbers[20], numbers[25]])
    world.update()
    assert len(world.rejected) == 0
    assert len(world.closures) == 20
    assert len(world.graph().edges) == 29 + 20
    for gone in (numbers[20], numbers[25]):
        with pytest.raises(masat.GraphError, match=f"no edge {gone}"):
            world.remove_edges(gone)
    with pytest.raises(masat.GraphError, match="twice"):
        world.remove_edges([numbers[21], numbers[21]])


def test_an_update_that_cannot_be_done_forgets_closures_as_well():
    world = OnlineMap(2, robust=True)
    circles(world, 20)
    world.add_pose(20)
    world.add_edges([(19, 20), (20, 0)], [(1e200, 0, 0), (1, 1, 1)], trusted=True)
    world.add_edges((3, 14), DIFFERENT_PLACE)
    with pytest.raises(OptimizationError):
        world.update()
    world.update()
    assert len(world.closures) == 12
    assert len(world) == 20
    world.add_pose(20)
    world.add_edges((19, 20), (1, 0, np.pi / 4), 100 * np.eye(3))
    world.update()
    assert len(world.rejected) == 0


@pytest.mark.parametrize("kind", ["random", "local", "grouped", "alias"])
@pytest.mark.parametrize("world", [worlds.manhattan(400, seed=3), worlds.grid(125)], ids=repr)
def test_spoiled_worlds(world, kind):
    clean, graph, is_false = spoiled(world, kind)
    run = replay(graph, robust=True)
    kept = ~np.isin(run.numbers, run.map.rejected)
    poses = run.map.poses[np.argsort(run.map.ids)]
    found = score(clean, graph, is_false, kept, poses)
    assert found.false_kept == 0
    assert found.true_kept >= 0.9 * found.true_closures
    result = run.map.optimize()
    batch = masat.solve(graph, robust=True)
    in_order = result.decision.kept[np.argsort(np.argsort(run.numbers))]
    assert (~in_order == np.isin(run.numbers, run.map.rejected)).all()
    assert result.decision.cost <= batch.decision.cost * 1.01
    assert score(clean, graph, is_false, in_order, result.poses).success


def test_same_input_same_map():
    _, graph, _ = spoiled(worlds.manhattan(400, seed=4), "alias")
    one, other = (replay(graph, robust=True).map for _ in range(2))
    assert (one.poses == other.poses).all()
    assert (
        one.closures == other.closures
    ).all() or one.closures.tobytes() == other.closures.tobytes()


def test_a_review_reverses_what_was_believed(monkeypatch):
    # Sure of nothing but odometry, the map believes a closure that all later ones contradict.
    monkeypatch.setattr(schedule, "_DOUBTED", 10)
    world = OnlineMap(2, robust=True)
    numbers = circles(world, 12)
    wrong = world.add_edges((0, 11), DIFFERENT_PLACE, 100 * np.eye(3))
    world.update()
    arrivals = world._arrivals
    # As if it had been believed, and the true ones had not.
    world._core.remove_edges(np.array(list(numbers.values())))
    arrivals._reject(np.array([arrivals.find(k) for k in numbers.values()]), 3)
    world._core.add_edges(
        np.array([[0, 11]]), np.array([DIFFERENT_PLACE]), 100 * np.eye(3)[None], wrong
    )
    arrivals._rows["state"][arrivals.find(int(wrong[0]))] = 2
    arrivals._count_again()
    world.update()
    assert world.rejected.tolist() == list(numbers.values())
    for k in range(12, 60):
        world.add_pose(k)
        world.add_edges((k - 1, k), (1, 0, np.pi / 4), 100 * np.eye(3))
        world.add_edges((k - 8, k), (0, 0, 0), 100 * np.eye(3))
        world.update()
    world.optimize()
    assert world.rejected.tolist() == wrong.tolist()
    assert world.chi2 == pytest.approx(0, abs=1e-9)


def test_the_map_leaves_a_wrong_minimum():
    graph = worlds.perturb(worlds.manhattan(1000, seed=0), (0.3, 0.3, 0.3), seed=0)
    best = masat.solve(graph).chi2
    run = replay(graph)
    assert run.map.chi2 < best * 1.02
    assert run.map.optimize().chi2 == pytest.approx(best, rel=1e-9)


def test_without_reviews_it_would_not(monkeypatch):
    monkeypatch.setattr(schedule, "_TURNED", np.inf)
    graph = worlds.perturb(worlds.manhattan(1000, seed=0), (0.3, 0.3, 0.3), seed=0)
    assert replay(graph).map.optimize().chi2 > masat.solve(graph).chi2 * 1.05


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_loaded_map_goes_on_judging(dimension, tmp_path):
    world = worlds.manhattan(300, seed=5) if dimension == 2 else worlds.grid(125)
    _, graph, _ = spoiled(world, "alias")
    half = graph.without_nodes(graph.ids[len(graph) // 2 :].tolist())
    first = replay(half, robust=True).map
    first._end_review()
    first.save(tmp_path / "half.npz")
    second = OnlineMap.load(tmp_path / "half.npz")
    assert second.robust
    assert second.closures.tobytes() == first.closures.tobytes()
    first._schedule = second._schedule
    newer = graph.edges.max(axis=1)
    for one in (first, second):
        for node in graph.ids[len(half) :].tolist():
            one.add_pose(node)
            rows = np.flatnonzero(newer == node)
            one.add_edges(graph.edges[rows], graph.measurements[rows], graph.information[rows])
        one.update()
    assert second.rejected.tolist() == first.rejected.tolist()
    np.testing.assert_allclose(second.poses, first.poses, atol=5e-3)


def test_a_plain_map_has_no_closures():
    world = OnlineMap(2)
    for k in range(4):
        world.add_pose(k)
    for pair, z in SQUARE:
        world.add_edges(pair, z)
    world.update()
    assert not world.robust
    assert len(world.closures) == len(world.rejected) == 0


def test_log_volume_is_that_of_the_batch():
    world = OnlineMap(2, robust=True)
    circles(world, 20)
    arrivals = world._arrivals
    arrivals._nodes = 0
    assert arrivals._log_volume(world._core) == log_volume(world.poses)


def test_what_a_review_found_is_solved():
    graph = worlds.perturb(worlds.manhattan(1000, seed=0), (0.3, 0.3, 0.3), seed=0)
    before, cores = 0.0, []
    run = OnlineMap(2)
    newer = graph.edges.max(axis=1)
    for node in graph.ids.tolist():
        run.add_pose(node)
        rows = np.flatnonzero(newer == node)
        if len(rows):
            rows = rows[np.argsort(np.abs(np.diff(graph.edges[rows]))[:, 0], kind="stable")]
            run.add_edges(graph.edges[rows], graph.measurements[rows], graph.information[rows])
        core, done = run._core, run.update()
        if run._core is not core:
            # Another map is only taken if it is better.
            cores.append(node)
            assert run.chi2 <= core.exact_chi2()
            assert done.chi2 == pytest.approx(run.chi2, rel=1e-2)
        before = run.chi2
    assert cores
    assert before > 0


def test_a_wrong_odometry_edge_is_released():
    world = worlds.normalized(
        masat.optimize(
            worlds.perturb(worlds.manhattan(200, seed=1), (0.05, 0.05, 0.02), seed=1)
        ).graph
    )
    z = world.measurements.copy()
    odometry = np.flatnonzero(np.abs(np.diff(world.edges))[:, 0] == 1)
    z[odometry[100]] = (4, 3, 1.5)
    graph = masat.PoseGraph.from_arrays(world.edges, z, world.information, ids=world.ids)
    batch = masat.solve(graph, robust=True)
    run = replay(graph, robust=True)
    result = run.map.optimize()
    assert result.chi2 == pytest.approx(batch.chi2, rel=0.05)
    assert int(run.numbers[odometry[100]]) in run.map.rejected.tolist()
    assert "trusted, but" in run.map.closures["reason"][~run.map.closures["kept"]].tolist()[0]
    again = run.map.optimize()
    assert again.chi2 == pytest.approx(result.chi2, rel=1e-6)


def test_parts_that_are_joined_during_a_review_stay_together(monkeypatch):
    monkeypatch.setattr(schedule, "_TURNED", -1.0)
    world = OnlineMap(2)
    circles(world, 40)
    for k in range(100, 140):
        world.add_pose(k)
        if k > 100:
            world.add_edges((k - 1, k), (1, 0, np.pi / 4), 100 * np.eye(3))
    world.update()
    assert world._review is not None
    found = world._review.outcome()
    seen = world._review.seen
    world.add_edges((5, 105), (3, 2, 2.5), 100 * np.eye(3))
    world.update()
    world._review = None
    poses = seen.poses
    changed = found._replace(poses=poses, roots=review.roots_of(seen.graph, seen.ids))
    monkeypatch.setattr(world, "_core", world._core)
    world._take_over(seen, changed)
    assert world.chi2 == pytest.approx(0, abs=1e-9)


def test_a_failed_update_undoes_removals_as_well():
    world = OnlineMap(2, robust=True)
    numbers = circles(world, 30, spoil=(20,))
    before = world.closures.tobytes()
    world.remove_edges([numbers[20], numbers[25]])
    world.add_pose(99)
    world.add_edges([(29, 99), (99, 0)], [(1e200, 0, 0), (1, 1, 1)], trusted=True)
    with pytest.raises(OptimizationError):
        world.update()
    assert world.closures.tobytes() == before
    assert world._core.has_edge(numbers[25])
    world.remove_edges([numbers[20], numbers[25]])
    world.update()
    assert len(world.closures) == 20


def test_closures_between_parts_are_judged_when_the_parts_connect():
    world = OnlineMap(2, robust=True)
    circles(world, 40)
    for k in range(100, 140):
        world.add_pose(k)
        if k > 100:
            world.add_edges((k - 1, k), (1, 0, np.pi / 4), 100 * np.eye(3))
    for k in range(5):
        world.add_edges((k, 108 + k), (0, 0, 0), 100 * np.eye(3))
    world.update()
    assert len(world.rejected) == 5
    world.add_edges((10, 110), (0, 0, 0), 100 * np.eye(3), trusted=True)
    world.update()
    # The trusted edge turns the second part so that node 108 is at node 8, which is at node 0.
    assert len(world.rejected) == 0
    assert world.chi2 == pytest.approx(0, abs=1e-9)


def test_odometry_that_is_corrected_is_trusted_again():
    world = OnlineMap(2, robust=True)
    circles(world, 20)
    world.add_pose(20)
    wrong = world.add_edges((19, 20), DIFFERENT_PLACE, 100 * np.eye(3))
    world.update()
    world.remove_edges(wrong)
    world.add_edges((19, 20), (1, 0, np.pi / 4), 100 * np.eye(3))
    world.update()
    assert len(world.rejected) == 0
    assert world.chi2 == pytest.approx(0, abs=1e-9)


def test_a_front_end_may_use_its_arrays_again():
    world = OnlineMap(2, robust=True)
    information = 100 * np.eye(3)[None]
    for k in range(4):
        world.add_pose(k)
        if k:
            world.add_edges(np.array([(k - 1, k)]), np.array([(1.0, 0, 0)]), information)
        world.update()
    information[:] = 1e-6 * np.eye(3)
    np.testing.assert_allclose(world._arrivals.trusted.variance_along(5)[-1], 0.03)


def test_the_same_closure_twice_does_not_support_itself():
    world, loose = drifted()
    for _ in range(2):
        world.add_edges((0, 60), (0.8, -0.6, 0.1), loose)
        world.update()
    assert len(world.rejected) == 30


def test_a_chain_does_not_turn():
    world = OnlineMap(2)
    for k in range(200):
        world.add_pose(k)
        world.update()
        if k:
            world.add_edges((k - 1, k), (1, 0, 1.0))
        world.update()
        assert world._review is None


def test_saving_before_an_update_saves_the_last_one(tmp_path):
    world = OnlineMap(2, robust=True)
    OnlineMap(2, robust=True).save(tmp_path / "empty.npz")
    assert OnlineMap.load(tmp_path / "empty.npz").robust
    numbers = circles(world, 20)
    before = world.closures.tobytes()
    world.add_pose(20)
    world.add_edges((19, 20), (1, 0, 0))
    world.add_edges((12, 20), (0, 0, 0))
    world.add_edges((3, 11), (0, 0, 0))
    world.remove_edges(numbers[15])
    world.save(tmp_path / "map.npz")
    loaded = OnlineMap.load(tmp_path / "map.npz")
    assert loaded.closures.tobytes() == before
    assert len(loaded) == 20


@pytest.mark.parametrize("trusted", [[True], np.array([True, False]), 1.0])
def test_trusted_is_one_answer_for_all(trusted):
    world = OnlineMap(2, robust=True)
    circles(world, 12)
    with pytest.raises(masat.GraphError, match="trusted must be"):
        world.add_edges((3, 9), (0, 0, 0), trusted=trusted)
    world.update()
    assert len(world.closures) == 4


def test_the_interpreter_ends_while_a_review_runs():
    program = """
import masat
from masat import worlds
from masat.online.schedule import Schedule
from masat.online.stream import replay
graph = worlds.perturb(worlds.manhattan(800, seed=0), (0.1, 0.1, 0.1), seed=0)
world = replay(graph).map
world._end_review()
world._schedule = Schedule(turned=1.0)
world.update()
assert world._review is not None
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, check=False)
    assert done.returncode == 0, done.stderr
