import json
import os
import shutil
from itertools import combinations

import numpy as np
import pytest
from random_graphs import random_graph

import masat
from masat import PartitionError, PoseGraph, lie
from masat._core import Elimination, NormalEquations, Topology
from masat.formats import streaming
from masat.formats.streaming import read_mapped
from masat.optimizers.damped import LocalSystem
from masat.optimizers.equations import normal_equations
from masat.parts import tasks
from masat.parts.covers import smallest_cover
from masat.parts.dissection import dissect, metis_labels
from masat.parts.engines import InTurn
from masat.parts.pieces import read_separators
from masat.parts.system import PartSystem
from masat.worlds import city, manhattan, perturb, sphere

CITY = masat.initialize(perturb(city(1000), (0.05, 0.05, 0.02)), "masat")
SPHERE = masat.initialize(perturb(sphere(400), (0.05, 0.02)), "masat")
GRAPHS = {"city": CITY, "sphere": SPHERE}


def packed(matrix):
    return np.concatenate([matrix[k:, k] for k in range(len(matrix))])


def scalars(nodes, d):
    return (np.asarray(nodes)[:, None] * d + np.arange(d)).ravel()


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize("seed", range(4))
def test_an_elimination_leaves_the_schur_complement_at_the_boundary(dimension, threads, seed):
    # The last node stands for a contribution block of some others, which comes from elsewhere.
    random = np.random.default_rng(seed)
    graph = random_graph(dimension, 60, 50, seed, noise=0.1)
    n, d = len(graph), graph.dof
    clique = random.permutation(n)[:9].astype(np.int32)
    boundary = random.permutation(n)[:7]
    inner = np.setdiff1d(np.arange(n), boundary)
    joined = np.stack([np.full(9, n), clique], 1)
    edges = np.concatenate([graph.edge_indices, joined]).astype(np.int32)
    order = np.concatenate([[n], random.permutation(inner), boundary]).astype(np.int32)
    elimination = Elimination(Topology(n + 1, edges), np.zeros(n + 1, bool), order, 7, 1)
    topology = Topology(n + 1, graph.edge_indices)
    equations = NormalEquations(
        topology, elimination, graph.measurements, graph.information, threads
    )
    equations.linearize(np.concatenate([graph.poses, graph.poses[:1]]))
    h = np.column_stack([equations.multiply(e) for e in np.eye((n + 1) * d)])
    root = random.normal(size=(9 * d, 9 * d))
    damping = random.uniform(0.1, 1, (n + 1) * d)
    assert equations.factorize(damping, [(clique, packed(root @ root.T))]) == -1
    h += np.diag(damping)
    h[np.ix_(scalars(clique, d), scalars(clique, d))] += root @ root.T
    i, b, rhs = scalars(inner, d), scalars(boundary, d), equations.rhs()
    gain = np.linalg.solve(h[np.ix_(i, i)], h[np.ix_(i, b)]).T
    schur = h[np.ix_(b, b)] - gain @ h[np.ix_(i, b)]
    np.testing.assert_allclose(
        equations.contribution(), packed(schur), rtol=0, atol=1e-12 * abs(schur).max()
    )
    reduced = equations.reduce(rhs)
    expected = rhs[b] - gain @ rhs[i]
    np.testing.assert_allclose(reduced[b], expected, rtol=0, atol=1e-12 * abs(rhs).max())
    reduced[b] = np.linalg.solve(schur, expected)
    every = np.concatenate([i, b])
    step = equations.substitute(reduced)[every]
    whole = np.linalg.solve(h[np.ix_(every, every)], rhs[every])
    np.testing.assert_allclose(step, whole, rtol=0, atol=1e-11 * abs(whole).max())


def test_a_part_alone_has_no_solution():
    graph = random_graph(2, 5, 2, 0, noise=0.1)
    order = np.arange(5, dtype=np.int32)
    elimination = Elimination(graph.topology, np.zeros(5, bool), order, 2)
    equations = NormalEquations(graph.topology, elimination, graph.measurements, graph.information)
    equations.linearize(graph.poses)
    assert equations.factorize(np.ones(15)) == -1
    with pytest.raises(RuntimeError, match="has a boundary"):
        equations.solve()


@pytest.mark.parametrize("seed", range(40))
def test_a_smallest_cover_is_one_that_no_smaller_set_is(seed):
    random = np.random.default_rng(seed)
    edges = np.stack([random.integers(0, 6, 12), random.integers(10, 16, 12)], 1)
    found = smallest_cover(edges[:, 0], edges[:, 1])
    assert np.isin(edges, found).any(axis=1).all()
    for smaller in combinations(np.unique(edges), len(found) - 1):
        assert not np.isin(edges, smaller).any(axis=1).all()


@pytest.mark.parametrize("parts", [1, 2, 3, 8])
@pytest.mark.parametrize("name", GRAPHS)
def test_separators_part_what_is_below_them(name, parts):
    graph = GRAPHS[name]
    tree = dissect(graph, metis_labels(graph, parts))

    def above(piece):
        found = {piece}
        while tree.parent[piece] >= 0:
            assert tree.parent[piece] > piece
            piece = tree.parent[piece]
            found.add(piece)
        return found

    lines = [above(piece) for piece in range(len(tree.parent))]
    assert (tree.piece >= 0).sum() == len(graph.structure.free)
    for a, b in tree.piece[graph.edge_indices].tolist():
        assert a < 0 or b < 0 or a in lines[b] or b in lines[a]
    # The parts are of about the same size, the separators are small.
    sizes = np.bincount(tree.piece[tree.piece >= 0])[:parts]
    assert sizes.max() < 1.5 * len(graph) / parts
    assert (tree.piece >= parts).sum() < 0.35 * len(graph)


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


@pytest.mark.parametrize("init", ["masat", "spanning_tree"])
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
    assert found.init == "masat"
    assert found.chi2 == pytest.approx(masat.optimize(CITY).chi2, rel=1e-9)


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


def spoil_missing(folder, other):
    (folder / "part-1.npz").unlink()
    return r"part-1.npz: is missing"


def spoil_torn(folder, other):
    path = folder / "part-2.npz"
    path.write_bytes(path.read_bytes()[:-100])
    return r"part-2.npz: has \d+ bytes in place of \d+: it is damaged"


def spoil_bits(folder, other):
    path = folder / "separator-0.npz"
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    return r"separator-0.npz: is damaged"


def spoil_other(folder, other):
    shutil.copy(other / "part-0.npz", folder / "part-0.npz")
    return r"part-0.npz: is of another graph than the index"


def spoil_index(folder, other):
    (folder / "index.json").write_text("{")
    return r"index.json: is damaged"


def spoil_everything(folder, other):
    (folder / "index.json").unlink()
    return r"holds no partition; make one with masat partition FILE -o"


def spoil_poses(folder, other):
    (folder / "state/given/part-3.npy").unlink()
    return r"given/part-3.npy: is missing"


SPOIL = [
    spoil_missing,
    spoil_torn,
    spoil_bits,
    spoil_other,
    spoil_index,
    spoil_everything,
    spoil_poses,
]


@pytest.mark.parametrize("spoil", SPOIL)
def test_a_damaged_partition_is_one_error_that_names_the_file(tmp_path, spoil):
    moved = CITY.with_poses(CITY.poses + 0)
    moved = PoseGraph.from_arrays(
        moved.edges, moved.measurements + 1e-3, moved.information, poses=moved.poses
    )
    masat.partition(CITY, tmp_path / "parts", 4)
    masat.partition(moved, tmp_path / "other", 4)
    message = spoil(tmp_path / "parts", tmp_path / "other")
    with pytest.raises(PartitionError, match=message):
        masat.Partition(tmp_path / "parts").solve()


def test_a_solve_of_another_graph_is_refused(tmp_path):
    masat.partition(CITY, tmp_path / "parts", 2).solve("gn", max_iterations=1)
    masat.partition(SPHERE, tmp_path / "other", 2).solve("gn", max_iterations=1)
    shutil.copy(tmp_path / "other/state/solve.json", tmp_path / "parts/state/solve.json")
    with pytest.raises(PartitionError, match=r"solve\.json: is of a solve of another graph"):
        masat.Partition(tmp_path / "parts").solve()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, "give either the number of parts or the part of each node"),
        ({"parts": 0}, "the number of parts must be from 1"),
        ({"labels": [0, 1]}, "labels must be 1000 integers"),
        ({"labels": -np.ones(1000, int)}, "parts are numbered from 0; node 0 has -1"),
    ],
)
def test_a_partition_that_cannot_be_is_refused(tmp_path, options, message):
    with pytest.raises(PartitionError, match=message):
        masat.partition(CITY, tmp_path / "parts", **options)


def test_a_folder_in_use_and_measurements_of_other_kinds_are_refused(tmp_path):
    with pytest.raises(PartitionError, match="cannot be cut into parts yet"):
        masat.partition(CITY.with_priors(masat.gps([5], [[1.0, 2.0]], 0.5)), tmp_path, 2)
    (tmp_path / "file").touch()
    with pytest.raises(PartitionError, match="is not empty"):
        masat.partition(CITY, tmp_path, 2)


def test_a_solve_that_cannot_be_is_refused(tmp_path):
    bare = PoseGraph.from_arrays(CITY.edges, CITY.measurements, CITY.information)
    made = masat.partition(bare, tmp_path / "parts", 2)
    with pytest.raises(PartitionError, match="has no poses yet"):
        made.poses()
    with pytest.raises(PartitionError, match="the graph had no poses"):
        made.solve(init="given")
    with pytest.raises(PartitionError, match="unknown initial guess 'chordal'"):
        made.solve(init="chordal")
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


def test_the_command_line_parts_solves_and_tells(run, tmp_path):
    file, folder, out = tmp_path / "city.g2o", tmp_path / "parts", tmp_path / "map.g2o"
    masat.write(CITY, file)
    code, text, err = run("partition", file, "-o", folder, "--parts", "4")
    assert (code, err) == (0, "")
    assert "parts" in text
    assert "workers" in text
    code, text, _ = run("info", folder, "--json")
    assert [cost["workers"] for cost in json.loads(text)["costs"]] == [1, 2, 4]
    assert run("status", folder)[1] == f"not solved yet: masat solve {folder}\n"
    code, text, _ = run("solve", folder, "--max-iterations", "1", "--optimizer", "gn", "--quiet")
    assert code == 1
    code, text, _ = run("solve", folder, "--optimizer", "gn", "-o", out)
    best = masat.optimize(masat.read(file), "gn")
    assert code == 0
    assert f"chi2 {best.chi2:.6g} in {best.iterations} iterations" in text
    assert masat.read(out).chi2 == pytest.approx(best.chi2, rel=1e-9)
    code, text, _ = run("status", folder)
    assert f"stopped, relative change, after {best.iterations} iterations" in text
    code, text, _ = run("solve", folder, "--json", "--restart")
    assert json.loads(text)["converged"]


@pytest.mark.parametrize("name", GRAPHS)
@pytest.mark.parametrize("suffix", [".g2o", ".g2o.gz"])
def test_a_graph_whose_measurements_stay_on_disk_is_the_same(tmp_path, monkeypatch, name, suffix):
    monkeypatch.setattr(streaming, "_BLOCK", 1000)
    path = tmp_path / f"graph{suffix}"
    masat.write(GRAPHS[name], path)
    graph, mapped = masat.read(path), read_mapped(path, tmp_path)
    for attribute in ("ids", "poses", "edges", "measurements", "information", "fixed"):
        assert np.array_equal(getattr(graph, attribute), getattr(mapped, attribute)), attribute


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("EDGE_SE2 0 1 1 0", r"graph.g2o:3070: "),
        ("EDGE_SE2 0 1 1 0 0 -1 0 0 1 0 1", r"graph.g2o:3070: .* first that of edge 1 \(0 -> 1\)"),
        ("EDGE_SE2 0 5000 1 0 0 1 0 0 1 0 1", r"5000, which is not among the nodes"),
        ("FIX 5000", r"the fixed node 5000 is not in the graph"),
        ("VERTEX_SE2 0 1 2 3", r"the node id 0 occurs twice"),
        ("EDGE_PRIOR_SE2_XY 0 1 2 1 0 1", r"holds priors or landmarks"),
    ],
)
def test_errors_of_a_graph_on_disk_name_the_line(tmp_path, monkeypatch, line, message):
    monkeypatch.setattr(streaming, "_BLOCK", 1000)
    path = tmp_path / "graph.g2o"
    masat.write(CITY, path)
    path.write_text(path.read_text() + line + "\n")
    with pytest.raises(masat.MasatError, match=message):
        read_mapped(path, tmp_path)


def test_the_command_line_takes_labels_and_refuses_what_does_not_fit(run, tmp_path):
    file, labels, folder = tmp_path / "city.g2o", tmp_path / "labels.txt", tmp_path / "parts"
    masat.write(CITY, file)
    np.savetxt(labels, np.stack([CITY.ids, CITY.ids // 500], 1), fmt="%d")
    assert run("partition", file, "-o", folder, "--labels", labels)[0] == 0
    assert masat.Partition(folder).index.parts == 2
    code, _, err = run("solve", folder, "--robust")
    assert code == 2
    assert "--robust does not go with a folder of parts" in err
    code, _, err = run("solve", file, "--restart")
    assert code == 2
    assert "--restart goes with a folder that masat partition made" in err
    labels.write_text("0 1 2\n")
    code, _, err = run("partition", file, "-o", tmp_path / "more", "--labels", labels)
    assert (code, err) == (2, f"masat: {labels}: has 3 columns, expected 'id part'\n")
