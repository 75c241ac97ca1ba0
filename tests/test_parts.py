import gc
import os
from dataclasses import replace

import numpy as np
import pytest
from random_graphs import random_graph

import masat
from masat import PartitionError, PoseGraph, lie
from masat.optimizers.damped import LocalSystem
from masat.optimizers.equations import normal_equations
from masat.parts import tasks
from masat.parts.checkpoints import GIVEN, read_poses, write_poses
from masat.parts.cost import homes
from masat.parts.elimination import PieceSystem
from masat.parts.engines import InTurn
from masat.parts.guess import GUESSES
from masat.parts.pieces import read_piece, read_separators
from masat.parts.system import PartSystem
from masat.worlds import add_false_closures, city, manhattan, perturb, sphere

CITY = masat.initialize(perturb(city(1000), (0.05, 0.05, 0.02)), "masat")
SPHERE = masat.initialize(perturb(sphere(400), (0.05, 0.02)), "masat")
GRAPHS = {"city": CITY, "sphere": SPHERE}


def system_of(folder):
    made = masat.Partition(folder)
    separators = [read_separators(folder / e.file, made.index.graph) for e in made.index.pieces]
    return PartSystem(made.index, InTurn(folder, made.index), separators)


@pytest.mark.parametrize("damping", [0.0, 0.5])
@pytest.mark.parametrize("name", GRAPHS)
def test_a_damped_step_is_that_of_the_whole_system(tmp_path, name, damping):
    graph = GRAPHS[name]
    masat.partition(graph, tmp_path, 4)
    system = system_of(tmp_path)
    local = LocalSystem(normal_equations(graph), graph.poses)
    chi2 = local.linearize(graph.poses)
    assert system.linearize("given") == pytest.approx(chi2, rel=1e-13)
    assert system.steepest() == pytest.approx(local.steepest(), rel=1e-10)
    step, expected = system.damped_step(damping), local.damped_step(damping)
    assert step.length() == pytest.approx(expected.length(), rel=1e-9)
    assert step.predicted() == pytest.approx(expected.predicted(), rel=1e-9)
    moved = local.retract(graph.poses, expected.step)
    assert system.chi2(system.retract("given", step.step)) == pytest.approx(
        local.chi2(moved), rel=1e-9
    )


@pytest.mark.parametrize("parts", [1, 2, 5, 8])
@pytest.mark.parametrize("optimizer", ["gn", "lm"])
@pytest.mark.parametrize("name", GRAPHS)
def test_a_solve_in_parts_is_that_of_one_process(tmp_path, name, optimizer, parts):
    graph = GRAPHS[name]
    made = masat.partition(graph, tmp_path / "parts", parts)
    found, best = made.solve(optimizer), masat.optimize(graph, optimizer)
    assert found.converged
    assert found.reason == best.reason
    assert found.iterations == best.iterations
    assert found.initial_chi2 == pytest.approx(best.initial_chi2, rel=1e-12)
    assert found.chi2 == pytest.approx(best.chi2, rel=1e-9)
    ids, poses = made.poses()
    assert np.array_equal(ids, graph.ids)
    assert np.abs(lie.local(best.poses, poses)).max() < 1e-8
    whole = made.graph()
    assert np.array_equal(whole.edges, graph.edges)
    assert np.array_equal(whole.measurements, graph.measurements)
    assert whole.chi2 == pytest.approx(found.chi2, rel=1e-12)


@pytest.mark.parametrize("loss", ["cauchy", "dcs"])
@pytest.mark.parametrize("name", GRAPHS)
def test_a_loss_in_parts_is_that_of_one_process(tmp_path, name, loss):
    spoiled, is_false = add_false_closures(GRAPHS[name], "random", 0.1, seed=1)
    graph = spoiled.with_poses(GRAPHS[name].poses)
    made = masat.partition(graph, tmp_path / "parts", 5)
    found = made.solve("lm", loss=loss, scale=2.0)
    best = masat.optimize(graph, "lm", loss=loss, scale=2.0)
    assert is_false.any()
    assert found.converged
    assert found.loss == loss
    assert found.initial_chi2 == pytest.approx(best.initial_chi2, rel=1e-12)
    assert found.robust_cost == pytest.approx(best.robust_cost, rel=1e-9)
    assert found.chi2 == pytest.approx(best.chi2, rel=1e-6)
    assert found.robust_cost < found.chi2


def test_a_loss_does_not_apply_to_trusted_edges(tmp_path):
    spoiled, is_false = add_false_closures(CITY, "random", 0.1, seed=1)
    graph = spoiled.with_poses(CITY.poses)
    odometry = np.abs(np.diff(graph.edges, axis=1))[:, 0] == 1
    made = masat.partition(graph, tmp_path / "parts", 5)
    found = made.solve(loss="tukey", trusted=odometry)
    best = masat.optimize(graph, "lm", loss="tukey", trusted=odometry)
    assert is_false.any()
    assert found.robust_cost == pytest.approx(best.robust_cost, rel=1e-9)
    # Another mask is another cost.
    other = made.solve(loss="tukey", max_iterations=0)
    assert other.initial_chi2 == pytest.approx(found.chi2, rel=1e-12)
    assert other.robust_cost < found.robust_cost
    assert other.history == ()


def test_threads_change_nothing_but_the_time(tmp_path, monkeypatch):
    asked = []
    make = tasks.PieceSystem.__init__

    def noted(self, nodes, loss, trusted, threads):
        asked.append(threads)
        make(self, nodes, loss, trusted, threads)

    monkeypatch.setattr(tasks.PieceSystem, "__init__", noted)
    made = masat.partition(SPHERE, tmp_path / "parts", 3)
    one = made.solve(threads=1).chi2, made.poses()[1]
    assert set(asked) == {1}
    asked.clear()
    assert made.solve(threads=2, restart=True).chi2 == one[0]
    assert set(asked) == {2}
    assert np.array_equal(made.poses()[1], one[1])
    with pytest.raises(masat.OptimizationError, match="threads must be from 1"):
        made.solve(threads=0)


def test_a_solve_with_another_loss_begins_at_the_poses_of_the_last(tmp_path):
    made = masat.partition(CITY, tmp_path / "parts", 4)
    plain = made.solve()
    robust = made.solve(loss="huber")
    assert robust.initial_chi2 == pytest.approx(plain.chi2, rel=1e-9)
    assert made.status().loss == ("huber", pytest.approx(3.368, rel=1e-3))
    again = made.solve(loss="huber")
    assert again.history[: robust.iterations] == robust.history
    assert made.solve(restart=True).chi2 == pytest.approx(plain.chi2, rel=1e-9)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"loss": "gnc_tls"}, "unknown loss 'gnc_tls' of a partition; known: cauchy"),
        ({"loss": "mine"}, "unknown loss 'mine'"),
        ({"loss": "cauchy", "scale": 0.0}, "scale of a loss must be positive"),
        ({"scale": 2.0}, "scale and trusted have no effect without a loss"),
        ({"trusted": np.ones(3, bool)}, "scale and trusted have no effect without a loss"),
        ({"loss": "huber", "trusted": np.ones(3, bool)}, "one entry an edge"),
    ],
)
def test_a_loss_that_parts_do_not_have_is_refused(tmp_path, options, message):
    with pytest.raises(masat.OptimizationError, match=message):
        masat.partition(CITY, tmp_path, 2).solve(**options)


def test_steps_that_make_chi2_worse_are_damped_as_in_one_process(tmp_path):
    graph = masat.initialize(perturb(manhattan(400, 700, extent=12), (0.2, 0.2, 0.2)), "odometry")
    found = masat.partition(graph, tmp_path / "parts", 4).solve("lm")
    best = masat.optimize(graph, "lm")
    assert any(one.damping > 1e-6 for one in best.history)
    assert [one.damping for one in found.history] == pytest.approx(
        [one.damping for one in best.history], rel=1e-3
    )
    assert found.chi2 == pytest.approx(best.chi2, rel=1e-9)


def test_parts_may_be_given(tmp_path):
    labels = CITY.ids * 6 // len(CITY)
    made = masat.partition(CITY, tmp_path / "parts", labels=labels)
    assert made.index.parts == 6
    assert made.solve("gn").chi2 == pytest.approx(masat.optimize(CITY, "gn").chi2, rel=1e-9)


def test_components_and_fixed_nodes_are_parted_too(tmp_path):
    a, b = random_graph(2, 40, 30, 1, noise=0.02), random_graph(2, 30, 20, 2, noise=0.02)
    graph = PoseGraph.from_arrays(
        np.concatenate([a.edges, b.edges + 100]),
        np.concatenate([a.measurements, b.measurements]),
        np.concatenate([a.information, b.information]),
        ids=np.concatenate([a.ids, b.ids + 100, [500]]),
        poses=np.concatenate([a.poses, b.poses, [[7.0, 8, 1]]]),
        fixed=[3, 17, 110],
    )
    for labels in (graph.ids // 100, graph.ids % 4):
        made = masat.partition(graph, tmp_path / str(labels[3]), labels=labels)
        found, best = made.solve("lm"), masat.optimize(graph, "lm")
        assert found.chi2 == pytest.approx(best.chi2, rel=1e-9)
        ids, poses = made.poses()
        assert np.array_equal(ids, graph.ids[:-1])
        np.testing.assert_allclose(poses, best.poses[:-1], atol=1e-7)


@pytest.mark.parametrize("init", GUESSES)
@pytest.mark.parametrize("name", GRAPHS)
def test_a_guess_goes_from_part_to_part(tmp_path, name, init):
    # Exact measurements: every path from the root leads to the same pose.
    exact = {"city": city(1000), "sphere": sphere(400)}[name]
    bare = PoseGraph.from_arrays(exact.edges, exact.measurements, exact.information)
    made = masat.partition(bare, tmp_path / "parts", 5)
    found = made.solve(init=init)
    assert found.init == init
    assert found.initial_chi2 < 1e-12
    np.testing.assert_allclose(
        lie.local(masat.initialize(bare, "masat").poses, made.poses()[1]), 0, atol=1e-9
    )


def test_a_solve_from_a_guess_by_parts_finds_the_minimum(tmp_path):
    bare = PoseGraph.from_arrays(CITY.edges, CITY.measurements, CITY.information)
    found = masat.partition(bare, tmp_path / "parts", 4).solve()
    assert found.init == "chordal"
    assert found.chi2 == pytest.approx(masat.optimize(CITY).chi2, rel=1e-9)


@pytest.mark.parametrize("memory", [None, 0])
@pytest.mark.parametrize("name", GRAPHS)
def test_the_chordal_guess_of_parts_is_that_of_the_graph(tmp_path, name, memory):
    graph = GRAPHS[name].with_fixed(GRAPHS[name].ids[[3, -1]])
    bare = replace(graph, fixed=graph.fixed[:1], poses=None)
    for given in (graph, bare):
        made = masat.partition(given, tmp_path / str(len(given.fixed)), 5)
        found = made.solve(init="chordal", max_iterations=0, memory=memory)
        whole = masat.initialize(given, "chordal")
        assert found.initial_chi2 == pytest.approx(whole.chi2, rel=1e-9)
        at = whole.index(made.poses()[0])
        np.testing.assert_allclose(lie.local(whole.poses[at], made.poses()[1]), 0, atol=1e-8)


def test_little_memory_takes_time_and_nothing_else(tmp_path, monkeypatch):
    reads = []
    read = tasks.read_piece
    monkeypatch.setattr(tasks, "read_piece", lambda path, *a: reads.append(path) or read(path, *a))
    found = []
    for memory in (0, 10**9):
        made = masat.partition(CITY, tmp_path / str(memory), 4)
        reads.clear()
        found.append((made.solve("lm", memory=memory), made.poses()[1], len(reads)))
    (little, poses, many), (much, others, few) = found
    assert little.chi2 == much.chi2
    assert np.array_equal(poses, others)
    assert few == len(made.index.pieces) < many


def test_an_interrupted_solve_goes_on(tmp_path):
    made = masat.partition(CITY, tmp_path / "parts", 4)
    assert made.status() is None

    def stop(iteration):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        made.solve("gn", report=stop)
    state = masat.Partition(tmp_path / "parts").status()
    assert state.reason is None
    assert len(state.history) == 1
    assert made.graph().chi2 == pytest.approx(state.chi2, rel=1e-12)
    rest = made.solve("gn")
    whole = masat.optimize(CITY, "gn")
    assert rest.iterations == whole.iterations
    assert rest.initial_chi2 == pytest.approx(whole.initial_chi2)
    assert rest.chi2 == pytest.approx(whole.chi2, rel=1e-9)
    assert made.status().reason == rest.reason.name
    assert made.solve("gn", restart=True).iterations == whole.iterations
    # Only the poses of the graph and the latest ones are kept.
    assert len([f for f in (tmp_path / "parts/state").iterdir() if f.is_dir()]) <= 3


def test_an_interrupted_linearization_leaves_nothing_half_known(tmp_path, monkeypatch):
    made = masat.partition(CITY, tmp_path / "parts", 4)
    engine = InTurn(made.folder, made.index)
    file = engine.files()[0]
    linearize = PieceSystem.linearize
    before = tasks.linearize(file, GIVEN)

    def stop(self, poses):
        linearize(self, poses + 0.1)
        raise KeyboardInterrupt

    piece = read_piece(made.folder / file.name, file.graph_hash, file.file_hash)
    poses = read_poses(file.folder, GIVEN, file.name, piece)
    write_poses(file.folder, "other", file.name, poses + 0.1)
    monkeypatch.setattr(PieceSystem, "linearize", stop)
    with pytest.raises(KeyboardInterrupt):
        tasks.linearize(file, "other")
    monkeypatch.undo()
    message = tasks.eliminate(file, tasks.Elimination(GIVEN, 0.0, 0.0, None), [])
    engine.release()
    fresh = tasks.eliminate(file, tasks.Elimination(GIVEN, 0.0, 0.0, None), [])
    engine.release()
    assert np.array_equal(message.block, fresh.block)
    assert np.array_equal(message.rhs, fresh.rhs)
    assert before.cost == tasks.linearize(file, GIVEN).cost
    engine.release()


def test_a_solve_leaves_no_factors_in_memory(tmp_path):
    masat.partition(CITY, tmp_path / "parts", 4).solve()
    gc.collect()
    assert not [one for one in gc.get_objects() if isinstance(one, PieceSystem)]


@pytest.mark.filterwarnings("ignore")
def test_a_cluster_that_loses_workers_finds_the_same_bits(tmp_path):
    distributed = pytest.importorskip("distributed")
    alone = masat.partition(CITY, tmp_path / "alone", 4)
    best = alone.solve("gn")
    made = masat.partition(CITY, tmp_path / "parts", 4)
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        killed = []

        def kill_one(iteration):
            if not killed:
                killed.append(next(iter(client.run(os.getpid).values())))
                os.kill(killed[-1], 9)

        found = made.solve("gn", client=client, report=kill_one)
    assert killed
    assert found.chi2 == best.chi2
    assert np.array_equal(made.poses()[1], alone.poses()[1])


def test_a_solve_that_cannot_be_is_refused(tmp_path):
    bare = PoseGraph.from_arrays(CITY.edges, CITY.measurements, CITY.information)
    made = masat.partition(bare, tmp_path / "parts", 2)
    with pytest.raises(PartitionError, match="has no poses yet"):
        made.poses()
    with pytest.raises(PartitionError, match="the graph had no poses"):
        made.solve(init="given")
    with pytest.raises(PartitionError, match="unknown initial guess 'lago'"):
        made.solve(init="lago")
    with pytest.raises(masat.OptimizationError, match="unknown optimizer 'dogleg'"):
        made.solve("dogleg")


def test_what_nothing_determines_is_named(tmp_path):
    graph = random_graph(2, 30, 20, 0, noise=0.01)
    information = graph.information.copy()
    touching = (graph.edges == 7).any(axis=1)
    information[touching] = 1e-300 * np.eye(3)
    weak = PoseGraph.from_arrays(graph.edges, graph.measurements, information, poses=graph.poses)
    found = masat.partition(weak, tmp_path / "parts", 3).solve("gn")
    best = masat.optimize(weak, "gn")
    assert found.reason == best.reason


def test_costs_follow_from_the_index(tmp_path):
    made = masat.partition(CITY, tmp_path / "parts", 4)
    one, two, four = made.costs()
    assert [one.workers, two.workers, four.workers] == [1, 2, 4]
    assert one.operations == one.critical == sum(e.operations for e in made.index.pieces)
    assert one.sent == 0 < two.sent < four.sent
    assert one.memory > two.memory > four.memory
    assert four.critical < two.critical < one.critical
    whole = CITY.elimination.operations(3)
    assert 0.5 * whole < one.operations < 5 * whole


def test_workers_without_a_part_have_no_separator(tmp_path):
    made = masat.partition(CITY, tmp_path / "parts", 2)
    *parts, separator = homes(made.index, 4)
    assert parts == [0, 2]
    assert separator in parts


def test_a_part_may_have_no_nodes_but_separators(tmp_path):
    graph = masat.PoseGraph.from_arrays(
        [(0, 1), (1, 2), (2, 3), (3, 4)], [(1, 0, 0)] * 4, [np.eye(3)] * 4
    )
    made = masat.partition(graph, tmp_path / "parts", labels=[0, 0, 1, 2, 2])
    assert made.solve("gn").chi2 < 1e-20
