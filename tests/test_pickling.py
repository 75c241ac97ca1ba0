import copy
import multiprocessing
import pickle
from concurrent.futures import ProcessPoolExecutor
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from random_graphs import random_graph
from test_measurements import graph_of_everything

import masat
from masat import FormatError, GraphError, InformationError, PoseGraph
from masat.structure import Structure

ARRAYS = ("ids", "poses", "edges", "measurements", "information", "fixed", "labels")
COMPUTED = ("edge_indices", "components", "gauge", "chi2_per_edge")
OF_STRUCTURE = ("ids", "edges", "fixed", "roots", "edge_indices", "components", "gauge", "free")
PROTOCOLS = range(2, pickle.HIGHEST_PROTOCOL + 1)


def labelled(dimension=2, labels="odometry"):
    """Return a graph that has all the arrays a graph can have."""
    graph = random_graph(dimension, 12, 9, seed=3, noise=0.01)
    count = len(graph.edges)
    return PoseGraph.from_arrays(
        graph.edges,
        graph.measurements,
        graph.information,
        poses=graph.poses,
        fixed=[4, 7],
        notes=["a note"],
        labels=[f"{labels} {k}" for k in range(count)] if labels else range(count),
    )


def used(graph):
    """Return the graph after everything that it keeps has been computed."""
    _ = graph.elimination, graph.structure.free, graph.chi2_per_edge, graph.topology, graph.gauge
    return graph


def out_of_band(value):
    """Send a value as joblib and dask do: the arrays apart from the rest, without copies."""
    buffers = []
    text = pickle.dumps(value, protocol=5, buffer_callback=buffers.append)
    return pickle.loads(text, buffers=[bytes(b.raw()) for b in buffers])


COPIES = {
    **{f"pickle {k}": lambda v, k=k: pickle.loads(pickle.dumps(v, protocol=k)) for k in PROTOCOLS},
    "buffers": out_of_band,
    "deepcopy": copy.deepcopy,
    "copy": copy.copy,
}


def locked_names(owner, names):
    """Return which of the arrays can be written to, or unlocked."""
    unlocked = []
    for name in names:
        array = getattr(owner, name)
        assert isinstance(array, np.ndarray)
        if array.flags.writeable or array.flags.owndata:
            unlocked.append(name)
            continue
        try:
            array.flags.writeable = True
        except ValueError:
            continue
        unlocked.append(name)
    return unlocked


def assert_same(graph, other):
    for field in fields(graph):
        if field.name == "structure":
            continue
        assert_array_equal(getattr(graph, field.name), getattr(other, field.name), strict=True)
    assert_array_equal(graph.gauge, other.gauge)
    assert_array_equal(graph.components, other.components)
    assert_array_equal(graph.chi2_per_edge, other.chi2_per_edge)
    assert graph.elimination.fill(3) == other.elimination.fill(3)


@pytest.mark.parametrize("labels", ["gps", None])
@pytest.mark.parametrize("dimension", [2, 3])
def test_no_array_of_a_graph_can_be_unlocked(dimension, labels):
    graph = labelled(dimension, labels)
    assert locked_names(graph, ARRAYS + COMPUTED) == []
    assert locked_names(graph.structure, OF_STRUCTURE) == []
    assert locked_names(graph.with_root(4).structure, OF_STRUCTURE) == []


CHANGES = {
    "with_poses": lambda g: g.with_poses(g.poses),
    "replace": lambda g: replace(g, poses=np.zeros((12, 3)), information=g.information.copy()),
    "with_edges": lambda g: g.with_edges([[0, 5], [5, 99]], [[1, 0, 0]] * 2),
    "without_edges": lambda g: g.without_edges([1]),
    "without_nodes": lambda g: g.without_nodes(3),
    "with_fixed": lambda g: g.with_fixed(3),
    "relabel": lambda g: g.relabel(lambda k: -k),
    "merge": lambda g: masat.merge([g, g]),
    "initialize": masat.initialize,
}


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_no_array_of_a_changed_graph_can_be_unlocked(change):
    graph = change(labelled())
    assert locked_names(graph, ARRAYS + COMPUTED) == []
    assert locked_names(graph.structure, OF_STRUCTURE) == []


def test_empty_arrays_of_a_graph_cannot_be_unlocked():
    graph = PoseGraph.from_arrays([], [], ids=[7, 3], poses=np.zeros((2, 3)), labels=[])
    assert locked_names(graph, ARRAYS + COMPUTED) == []


@pytest.mark.parametrize("copied", COPIES.values(), ids=COPIES)
@pytest.mark.parametrize("prepared", [lambda graph: graph, used], ids=["new", "used"])
@pytest.mark.parametrize("dimension", [2, 3])
def test_a_copied_graph_is_the_same_and_read_only(dimension, prepared, copied):
    graph = prepared(labelled(dimension))
    other = copied(graph)
    assert locked_names(other, ARRAYS + COMPUTED) == []
    assert locked_names(other.structure, OF_STRUCTURE) == []
    assert_same(graph, other)
    assert_same(graph, copied(other))


@pytest.mark.parametrize("copied", COPIES.values(), ids=COPIES)
@pytest.mark.parametrize("dimension", [2, 3])
def test_copied_priors_and_landmarks_are_the_same_and_read_only(dimension, copied):
    graph = graph_of_everything(dimension)
    other = copied(graph)
    for part in ("priors", "landmarks"):
        old, new = getattr(graph, part), getattr(other, part)
        names = [field.name for field in fields(old)]
        assert locked_names(new, names) == locked_names(copied(new), names) == []
        for name in names:
            assert_array_equal(getattr(old, name), getattr(new, name))


@pytest.mark.parametrize("copied", COPIES.values(), ids=COPIES)
def test_a_chosen_root_and_the_shared_structure_survive_a_copy(copied):
    graph = random_graph(2, 12, 9, seed=3).with_root(5)
    first, second = copied([graph, replace(graph, poses=None)])
    assert first.gauge.tolist() == second.gauge.tolist() == [5]
    assert first.structure is second.structure
    assert replace(first, poses=None).structure is first.structure


def test_a_pickle_is_no_larger_after_use():
    graph = labelled()
    before = len(pickle.dumps(graph))
    assert len(pickle.dumps(used(graph))) == before
    # Neither are ids, edges and fixed nodes written twice.
    assert len(pickle.dumps(graph)) < 1.1 * len(pickle.dumps([getattr(graph, a) for a in ARRAYS]))


@pytest.mark.parametrize("copied", COPIES.values(), ids=COPIES)
def test_a_result_and_a_certificate_survive_a_copy(copied):
    graph = labelled(3)
    result = masat.optimize(used(graph))
    other = copied(result)
    assert_same(result.graph, other.graph)
    assert locked_names(other, ["gauge", "poses"]) == []
    assert locked_names(other.graph, ARRAYS + COMPUTED) == []
    for field in fields(result):
        if field.name not in ("graph", "gauge"):
            assert getattr(other, field.name) == getattr(result, field.name)
    assert_array_equal(other.gauge, result.gauge)
    certificate = masat.certify(result.graph)
    assert copied(certificate).message == certificate.message
    assert copied(replace(certificate, better=graph)).better.gauge.tolist() == [4, 7]


def test_a_saved_result_keeps_labels_and_the_chosen_root(tmp_path):
    graph = random_graph(2, 12, 9, seed=3, noise=0.01).with_root(5)
    labels = [f"edge {k}" for k in range(len(graph.edges))]
    result = masat.optimize(replace(graph, labels=np.array(labels)))
    result.save(tmp_path / "result.npz")
    loaded = masat.Result.load(tmp_path / "result.npz")
    assert loaded.gauge.tolist() == loaded.graph.gauge.tolist() == [5]
    assert loaded.graph.labels.tolist() == labels
    assert locked_names(loaded, ["gauge", "poses"]) == []


def test_a_structure_can_be_pickled_without_its_graph():
    structure = used(labelled()).structure
    other = pickle.loads(pickle.dumps(structure))
    assert isinstance(other, Structure)
    assert other.gauge.tolist() == structure.gauge.tolist() == [4, 7]
    assert other.elimination.fill(3) == structure.elimination.fill(3)


ERRORS = [
    GraphError("edge 3 is at fault", edge=3),
    InformationError("2 are not positive definite", edge=1, count=2),
    FormatError("no number", Path("a.g2o"), 7),
    masat.OptimizationError("no poses"),
]


@pytest.mark.parametrize("error", ERRORS, ids=lambda e: type(e).__name__)
def test_errors_come_back_from_other_processes(error):
    for protocol in PROTOCOLS:
        other = pickle.loads(pickle.dumps(error, protocol=protocol))
        assert (type(other), str(other), vars(other)) == (type(error), str(error), vars(error))


def optimized(graph):
    return masat.optimize(graph)


def refused(graph):
    return graph.with_edges([[0, 0]], [[0, 0, 0]])


def test_graphs_go_through_a_process_pool_before_and_after_use():
    graphs = [labelled(), used(labelled())]
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=context) as pool:
        results = list(pool.map(optimized, graphs))
        with pytest.raises(GraphError, match="edge 0 joins node 0 to itself") as caught:
            pool.submit(refused, graphs[0]).result()
    assert caught.value.edge == 0
    expected = masat.optimize(labelled()).poses
    for result in results:
        assert_array_equal(result.poses, expected)
        assert locked_names(result.graph, ARRAYS + COMPUTED) == []


def test_graphs_go_through_joblib(tmp_path):
    joblib = pytest.importorskip("joblib")
    graph = used(labelled())
    # The low limit makes joblib send all arrays as memory maps.
    results = joblib.Parallel(n_jobs=2, max_nbytes=1, temp_folder=tmp_path)(
        joblib.delayed(optimized)(graph) for _ in range(2)
    )
    expected = masat.optimize(graph).poses
    for result in results:
        assert_array_equal(result.poses, expected)
        assert locked_names(result.graph, ARRAYS + COMPUTED) == []
    joblib.dump(graph, tmp_path / "graph.joblib")
    assert_same(joblib.load(tmp_path / "graph.joblib"), graph)
    assert_same(joblib.load(tmp_path / "graph.joblib", mmap_mode="r"), graph)
