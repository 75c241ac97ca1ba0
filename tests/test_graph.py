from dataclasses import FrozenInstanceError
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from masat import GraphError, InformationError, MasatError, PoseGraph

LOWEST, HIGHEST = -(2**63), 2**63 - 1
EDGES = [[10, 20], [20, 30], [30, 10]]
PLANAR = {"edges": EDGES, "measurements": [[1, 2, 0.5], [3, 4, -0.5], [5, 6, 4]]}
SPATIAL = {"edges": EDGES, "measurements": [[1, 2, 3, 0, 0, 0, 1]] * 3}
POSES = [[1, 1, 0.1], [2, 2, 0.2], [3, 3, 0.3]]


def triangle(base=PLANAR, **changes):
    return PoseGraph.from_arrays(**(base | changes))


def joined(edges, **more):
    """Return a planar graph with these edges, all measuring the same."""
    return PoseGraph.from_arrays(edges, [[1, 0, 0]] * len(edges), **more)


def spatial_with(row, quaternion):
    measurements = np.array(SPATIAL["measurements"], float)
    measurements[row, 3:] = quaternion
    return measurements


@pytest.mark.parametrize(("base", "dimension", "dof"), [(PLANAR, 2, 3), (SPATIAL, 3, 6)])
def test_plain_lists_of_edges_and_measurements_are_enough(base, dimension, dof):
    graph = PoseGraph.from_arrays(base["edges"], base["measurements"])
    assert (graph.dimension, graph.dof) == (dimension, dof)
    assert_array_equal(graph.ids, [10, 20, 30])
    assert_array_equal(graph.edges, EDGES)
    assert_array_equal(graph.measurements, base["measurements"])
    assert_array_equal(graph.information, [np.eye(dof)] * 3)
    assert graph.poses is None
    assert graph.fixed.size == 0
    assert graph.notes == ()
    assert (graph.ids.dtype, graph.measurements.dtype) == (np.int64, np.float64)


def test_the_representation_tells_size_and_whether_there_are_poses():
    assert repr(triangle()) == "PoseGraph(2D, 3 nodes, 3 edges, without poses)"
    assert repr(triangle(poses=POSES)) == "PoseGraph(2D, 3 nodes, 3 edges, with poses)"


def test_poses_are_sorted_along_with_their_ids():
    graph = triangle(ids=[30, 10, 20], poses=[[3, 3, 0.3], [1, 1, 0.1], [2, 2, 0.2]])
    assert_array_equal(graph.ids, [10, 20, 30])
    assert_array_equal(graph.poses, POSES)


@given(st.permutations(range(6)), st.sampled_from([1, 7]))
def test_the_order_in_which_nodes_are_given_does_not_matter(order, gap):
    ids, poses = np.arange(6) * gap - 3, np.arange(18.0).reshape(6, 3)
    edges = np.column_stack([ids[:-1], ids[1:]])
    graph = joined(edges, ids=ids[order], poses=poses[order], fixed=ids[order][:2])
    assert_array_equal(graph.ids, ids)
    assert_array_equal(graph.poses, poses)
    assert_array_equal(graph.fixed, np.sort(ids[order][:2]))
    assert_array_equal(graph.ids[graph.edge_indices], edges)


@pytest.mark.parametrize(
    "path",
    [
        [0, 1, 2],
        [-5, 3, 1000],
        [LOWEST, 0, HIGHEST],
        [LOWEST, LOWEST + 1, LOWEST + 2],
        [HIGHEST - 2, HIGHEST - 1, HIGHEST],
        # Neighbors that one double cannot tell apart.
        [2**53, 2**53 + 1, 2**60],
    ],
)
def test_ids_may_be_any_integers_of_64_bits(path):
    a, b, c = path
    graph = joined([[c, b], [b, a]], ids=[b, c, a], fixed=[c])
    assert graph.ids.tolist() == path
    assert graph.edges.tolist() == [[c, b], [b, a]]
    assert graph.edge_indices.tolist() == [[2, 1], [1, 0]]
    assert graph.index([a, b, c]).tolist() == [0, 1, 2]
    assert graph.fixed.tolist() == [c]
    assert graph.gauge.tolist() == [c]


@pytest.mark.parametrize("kind", [np.int8, np.uint8, np.int32, np.uint64])
def test_ids_of_any_integer_type_are_taken(kind):
    graph = joined(np.array([[3, 100]], kind), ids=np.array([100, 3], kind))
    assert graph.ids.tolist() == [3, 100]
    assert graph.ids.dtype == np.int64


def test_one_information_matrix_is_that_of_every_edge():
    matrix = [[4, 1, 0], [1, 5, 0], [0, 0, 6]]
    assert_array_equal(triangle(information=matrix).information, [matrix] * 3)


def test_each_edge_keeps_its_own_information():
    matrices = np.array([np.diag([k, 2 * k, 3 * k]) for k in (1.0, 2.0, 3.0)])
    assert_array_equal(triangle(information=matrices).information, matrices)


def test_information_off_symmetry_by_rounding_is_averaged():
    matrix = np.diag([1e6, 1.0, 1.0])
    matrix[0, 1], matrix[1, 0] = 1.0, 1.0 + 2**-40
    graph = triangle(information=matrix)
    assert_array_equal(graph.information[:, 0, 1], [1 + 2**-41] * 3)
    assert_array_equal(graph.information, graph.information.transpose(0, 2, 1))


def test_the_callers_arrays_are_copied():
    given = {
        "edges": np.array(EDGES),
        "measurements": spatial_with(1, [0, 0, 0.6000001, 0.8]),
        "information": np.array([np.eye(6)] * 3),
        "ids": np.array([10, 20, 30]),
        "poses": spatial_with(0, [0, 0, 0.6000001, 0.8]),
    }
    before = {name: array.copy() for name, array in given.items()}
    graph = PoseGraph.from_arrays(**given)
    for name, array in given.items():
        assert_array_equal(array, before[name])
        kept = getattr(graph, name).copy()
        array[:] = 99
        assert_array_equal(getattr(graph, name), kept)


def test_one_matrix_for_a_single_edge_is_copied_too():
    matrix = np.eye(3)
    graph = joined([[0, 1]], information=matrix)
    matrix[0, 0] = -1
    assert_array_equal(graph.information[0], np.eye(3))


@pytest.mark.parametrize("information", [None, np.eye(3), [np.eye(3)] * 3])
@pytest.mark.parametrize(
    "name",
    [
        *("ids", "poses", "edges", "measurements", "information", "fixed"),
        *("edge_indices", "components", "gauge"),
    ],
)
def test_arrays_of_a_graph_are_read_only(name, information):
    graph = triangle(poses=POSES, fixed=[10], information=information)
    with pytest.raises(ValueError, match="read-only"):
        getattr(graph, name)[...] = 0


def test_attributes_of_a_graph_cannot_be_replaced():
    with pytest.raises(FrozenInstanceError):
        triangle().poses = np.zeros((3, 3))


@pytest.mark.parametrize("name", ["measurements", "poses"])
def test_quaternions_off_unit_length_by_rounding_are_normalized(name):
    rounded = spatial_with(1, [0.6, 0, 0, -0.8 - 1e-7])
    graph = triangle(SPATIAL, **{"poses": rounded, name: rounded})
    got = getattr(graph, name)
    assert_allclose(np.linalg.norm(got[:, 3:], axis=1), 1, rtol=0, atol=2.3e-16)
    assert_allclose(got, rounded, rtol=0, atol=1e-7)
    assert_array_equal(got[:, :3], rounded[:, :3])


def test_headings_are_kept_as_given():
    assert triangle().measurements[2, 2] == 4


@pytest.mark.parametrize(
    ("base", "changes", "message"),
    [
        ({}, {"edges": [], "measurements": []}, "no node"),
        ({}, {"edges": [], "measurements": [], "ids": []}, "no node"),
        (PLANAR, {"edges": EDGES[:2]}, "2 edges but 3 measurements"),
        (PLANAR, {"edges": [10, 20, 30]}, r"edges must have shape \(m, 2\), got \(3,\)"),
        (PLANAR, {"edges": [[1, 2, 3]] * 3}, r"edges must have shape \(m, 2\), got \(3, 3\)"),
        (PLANAR, {"edges": [[1, 2], [3]]}, "edges must be integers"),
        (PLANAR, {"edges": np.array(EDGES, float)}, "edges must be integers .* float64"),
        (PLANAR, {"edges": np.array(EDGES, bool)}, "edges must be integers .* bool"),
        (PLANAR, {"edges": np.array(EDGES, str)}, "edges must be integers"),
        (PLANAR, {"edges": np.array(EDGES, np.uint64) + 2**63}, "edges must be .* 64 bits"),
        (PLANAR, {"edges": [[2**63, -1]] * 3}, "edges must be .* 64 bits"),
        (PLANAR, {"edges": [[2**80, 1]] * 3}, "edges must be .* 64 bits"),
        (PLANAR, {"measurements": [1, 2, 3]}, r"measurements must be a table.* got shape \(3,\)"),
        (PLANAR, {"measurements": np.ones((3, 6))}, r"measurements .* got \(3, 6\)"),
        (PLANAR, {"measurements": [["a", "b", "c"]] * 3}, "measurements must be numbers"),
        (PLANAR, {"measurements": [[1, 2, 3j]] * 3}, "measurements must be numbers"),
        (PLANAR, {"measurements": [[1, 2, 3], [4, 5]]}, "measurements must be numbers"),
        (PLANAR, {"measurements": [[10**400, 0, 0]] * 3}, "measurements must be numbers"),
        (PLANAR, {"ids": [10.0, 20.0, 30.0]}, "ids must be integers .* float64"),
        (PLANAR, {"ids": [[10, 20, 30]]}, r"ids must have shape \(n,\), got \(1, 3\)"),
        (PLANAR, {"poses": POSES[:2]}, r"poses must have shape \(3, 3\).* got \(2, 3\)"),
        (PLANAR, {"poses": np.ones((3, 7))}, r"poses must have shape \(3, 3\).* got \(3, 7\)"),
        (SPATIAL, {"poses": POSES}, r"poses must have shape \(3, 7\).* got \(3, 3\)"),
        (PLANAR, {"fixed": [11]}, "the fixed node 11 is not in the graph"),
        (PLANAR, {"fixed": [10.0]}, "fixed must be integers"),
        (PLANAR, {"fixed": [10, 20]}, "several fixed nodes of one component need poses"),
        (PLANAR, {"information": np.eye(6)}, r"\(3, 3, 3\) or \(3, 3\), got \(6, 6\)"),
        (SPATIAL, {"information": np.eye(3)}, r"\(3, 6, 6\) or \(6, 6\), got \(3, 3\)"),
        (PLANAR, {"information": [np.eye(3)] * 2}, r"got \(2, 3, 3\)"),
        (PLANAR, {"information": [["a"] * 3] * 3}, "information must be numbers"),
        (PLANAR, {"information": [[1, 2], [3]]}, "information must be numbers"),
    ],
)
def test_what_makes_no_graph_is_refused_with_its_reason(base, changes, message):
    with pytest.raises(GraphError, match=message):
        triangle(base, **changes)


MASKED = np.ma.array([[1.0, 2, 0.5], [3, 4, -0.5], [5, 6, 4]])
MASKED[1, 2] = np.ma.masked
MASKED_IDS = np.ma.array([[10, 20], [20, 30], [30, 10]])
MASKED_IDS[2, 0] = np.ma.masked
MASKED_INFORMATION = np.ma.array([np.eye(3)] * 3)
MASKED_INFORMATION[2, 1, 1] = np.ma.masked
FRACTIONS = [[Fraction(1, 2), 0, 0]] * 3


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        # Imaginary parts, also those that are zero.
        ({"measurements": np.ones((3, 3), complex)}, "measurements must be numbers, got complex"),
        ({"poses": np.ones((3, 3), complex)}, "poses must be numbers, got complex numbers"),
        ({"information": np.eye(3) + 0j}, "information must be numbers, got complex numbers"),
        ({"edges": np.array(EDGES, complex)}, "edges must be integers .* complex numbers"),
        # Masks.
        ({"measurements": MASKED}, "row 1 of measurements is masked: fill it in or leave it out"),
        ({"measurements": list(MASKED)}, "row 1 of measurements is masked"),
        ({"poses": MASKED}, "row 1 of poses is masked"),
        ({"edges": MASKED_IDS}, "row 2 of edges is masked"),
        ({"ids": np.ma.array([10, 20, 30], mask=[1, 0, 0])}, "row 0 of ids is masked"),
        ({"fixed": np.ma.array([10], mask=[1])}, "row 0 of fixed is masked"),
        ({"fixed": np.ma.masked}, "fixed is masked"),
        ({"information": MASKED_INFORMATION}, "row 2 of information is masked"),
        # What is neither a number nor an integer.
        ({"measurements": np.array(FRACTIONS)}, r"got an object such as Fraction\(1, 2\)"),
        ({"measurements": np.array(MASKED, object)}, "measurements must be numbers, got an object"),
        ({"measurements": [["1", "2", "3"]] * 3}, "measurements must be numbers, got strings"),
        ({"measurements": np.ones((3, 3), bool)}, "measurements must be numbers, got booleans"),
        ({"measurements": [[1, 2, None]] * 3}, "measurements must be numbers, got an object"),
        ({"measurements": None}, "measurements must be numbers, got an object such as None"),
        ({"poses": np.zeros((3, 3), "M8[s]")}, "poses must be numbers, got dates"),
        ({"edges": np.array(EDGES, object)}, "edges must be integers .* an object such as 10"),
        ({"edges": [[None, 1]] * 3}, "edges must be integers .* an object such as None"),
        ({"edges": "abc"}, "edges must be integers .* strings"),
        ({"ids": [True, False, True]}, "ids must be integers .* booleans"),
        ({"ids": [np.nan, 20, 30]}, "ids must be integers .* float64"),
        ({"ids": ["10", "20", "30"]}, "ids must be integers .* strings"),
        # Lists of different lengths.
        ({"measurements": [[1, 2, 3], [4, 5, 6], [7, 8]]}, "row 2 is not as long as row 0"),
        ({"poses": [[1, 2, 3], [4, 5], [7, 8, 9]]}, "poses must be .*row 1 is not as long"),
        ({"edges": [[1, 2], [3], [4, 5]]}, "edges must be integers: row 1 is not as long"),
        ({"information": [np.eye(3), np.eye(2), np.eye(3)]}, "row 1 is not as long as row 0"),
    ],
)
def test_values_that_are_no_numbers_are_refused_in_one_clear_sentence(changes, message):
    with pytest.raises(GraphError, match=message):
        triangle(PLANAR, **changes)


def test_masked_arrays_without_masked_entries_are_taken():
    graph = triangle(measurements=np.ma.array(PLANAR["measurements"], mask=False))
    assert_array_equal(graph.measurements, PLANAR["measurements"])
    assert type(graph.measurements) is np.ndarray


@pytest.mark.parametrize("poses", [None, [[0, 0, 0, 0, 0, 0, 1]] * 2])
def test_no_measurements_of_seven_columns_make_a_spatial_graph(poses):
    graph = PoseGraph.from_arrays([], np.zeros((0, 7)), ids=[3, 7], poses=poses)
    assert graph.dimension == 3
    assert graph.measurements.shape == (0, 7)
    assert graph.information.shape == (0, 6, 6)


@pytest.mark.parametrize(
    ("measurements", "poses", "message"),
    [
        (np.zeros((0, 7)), np.zeros((2, 3)), r"poses must have shape \(2, 7\).* got \(2, 3\)"),
        (np.zeros((0, 3)), [[0, 0, 0, 0, 0, 0, 1]] * 2, r"poses must have shape \(2, 3\)"),
        (np.zeros((0, 5)), None, r"measurements must have shape .*, got \(0, 5\)"),
        ([], np.zeros((2, 4)), r"measurements must have shape .*, got \(0, 4\)"),
    ],
)
def test_no_measurements_and_poses_of_another_group_are_refused(measurements, poses, message):
    with pytest.raises(GraphError, match=message):
        PoseGraph.from_arrays([], measurements, ids=[3, 7], poses=poses)


EDGES_AT_FAULT = [
    (PLANAR, {"edges": [[1, 2], [2, 2], [3, 3]]}, 1, "edge 1 joins node 2 to itself"),
    (PLANAR, {"ids": [10, 20]}, 1, r"edge 1 \(20 -> 30\) names node 30, which is not among"),
    (PLANAR, {"ids": [8, 9, 10, 30]}, 0, r"edge 0 \(10 -> 20\) names node 20"),
    (PLANAR, {"ids": [20, 30, 40]}, 0, r"edge 0 \(10 -> 20\) names node 10"),
    (PLANAR, {"measurements": [[0, 0, 0], [0, np.nan, 0], [0, 0, 0]]}, 1, "is not finite"),
    (SPATIAL, {"measurements": spatial_with(1, [0, 0, -np.inf, 1])}, 1, "is not finite"),
    (SPATIAL, {"measurements": spatial_with(2, [0, 0, 0, 0])}, 2, "of length 0, expected 1"),
    (SPATIAL, {"measurements": spatial_with(2, [0, 0, 0, 0.9])}, 2, r"of length 0\.9, expected 1"),
    (SPATIAL, {"measurements": spatial_with(2, [1e200, 0, 0, 0])}, 2, "of length .*, expected 1"),
    (PLANAR, {"information": [np.eye(3), np.diag([1, np.nan, 1]), np.eye(3)]}, 1, "not finite"),
    (PLANAR, {"information": np.diag([1, np.inf, 1])}, 0, "is not finite"),
]


@pytest.mark.parametrize(("base", "changes", "edge", "message"), EDGES_AT_FAULT)
def test_the_first_edge_at_fault_is_named(base, changes, edge, message):
    with pytest.raises(GraphError, match=message) as caught:
        triangle(base, **changes)
    assert f"edge {edge}" in str(caught.value)
    assert (caught.value.edge, caught.value.node) == (edge, None)


NODES_AT_FAULT = [
    (PLANAR, {"ids": [30, 10, 20, 10]}, 3, "the node id 10 occurs twice"),
    (PLANAR, {"poses": [[0, 0, 0], [0, 0, np.inf], [0, 0, 0]]}, 1, "node 10 is not finite"),
    (SPATIAL, {"poses": spatial_with(1, [0, 3, 0, 4])}, 1, "node 10 .* of length 5, expected 1"),
    (SPATIAL, {"poses": spatial_with(1, [0, 0, 0, 0])}, 1, "node 10 .* of length 0, expected 1"),
]


@pytest.mark.parametrize(("base", "changes", "index", "message"), NODES_AT_FAULT)
def test_the_first_node_at_fault_is_named_with_its_index_in_the_input(
    base, changes, index, message
):
    with pytest.raises(GraphError, match=message) as caught:
        triangle(base, **({"ids": [30, 10, 20]} | changes))
    assert (caught.value.edge, caught.value.node) == (None, index)


ASYMMETRIC = np.array([[1, 1e-7, 0], [0, 1, 0], [0, 0, 1]])
SKEW = np.array([[1, 1e308, 0], [-1e308, 1, 0], [0, 0, 1]])
INDEFINITE = np.diag([1.0, -1.0, 1.0])
# Elimination overflows to infinity times zero here.
STEEP = np.array([[1e-300, 0, 1e200], [0, 1, 0], [1e200, 0, 1]])


@pytest.mark.parametrize(
    ("matrix", "message"),
    [
        (ASYMMETRIC, "is not symmetric"),
        (SKEW, "is not symmetric"),
        (INDEFINITE, "smallest eigenvalue -1$"),
        (np.zeros((3, 3)), "smallest eigenvalue 0$"),
        (STEEP, "or not positive semidefinite"),
    ],
)
def test_information_that_is_not_positive_definite_is_counted(matrix, message):
    good = np.diag([1.0, 2.0, 3.0])
    edges = [[0, 1], [1, 2], [2, 3], [3, 4], [4, 0]]
    with pytest.raises(InformationError, match=message) as caught:
        joined(edges, information=[good, matrix, good, matrix, good])
    assert "of 2 of 5 edges" in str(caught.value)
    assert "edge 1 (1 -> 2)" in str(caught.value)
    assert (caught.value.edge, caught.value.count) == (1, 2)
    with pytest.raises(InformationError) as caught:
        joined(edges, information=matrix)
    assert (caught.value.edge, caught.value.count) == (0, 5)


def test_six_by_six_information_is_checked_too():
    with pytest.raises(InformationError, match="smallest eigenvalue -2"):
        triangle(SPATIAL, information=np.diag([1, 1, 1, 1, 1, -2]))


def test_information_too_large_to_be_averaged_does_not_become_infinite():
    matrix = np.diag([1.7e308] * 3)
    matrix[0, 1], matrix[1, 0] = 1e300, 1e300 * (1 + 1e-14)
    assert np.isfinite(triangle(information=matrix).information).all()


def test_errors_are_value_errors_and_of_one_family():
    assert issubclass(InformationError, GraphError)
    assert issubclass(GraphError, ValueError)
    assert issubclass(GraphError, MasatError)


def test_several_fixed_nodes_of_different_components_need_no_poses():
    graph = joined([[0, 1], [2, 3]], fixed=[3, 0, 3])
    assert_array_equal(graph.fixed, [0, 3])


def test_several_fixed_nodes_of_one_component_are_taken_with_their_poses():
    assert_array_equal(triangle(poses=POSES, fixed=[30, 10]).fixed, [10, 30])


@pytest.mark.parametrize("poses", [None, np.zeros((2, 3)), [[0, 0, 0, 0, 0, 0, 1]] * 2])
def test_a_graph_may_have_nodes_and_no_edge(poses):
    graph = PoseGraph.from_arrays([], [], ids=[7, 3], poses=poses)
    size, dof = (7, 6) if np.shape(poses) == (2, 7) else (3, 3)
    assert_array_equal(graph.ids, [3, 7])
    assert graph.edges.shape == graph.edge_indices.shape == (0, 2)
    assert graph.measurements.shape == (0, size)
    assert graph.information.shape == (0, dof, dof)
    assert_array_equal(graph.components, [0, 1])
    assert_array_equal(graph.gauge, [3, 7])


def test_nodes_without_edges_are_components_of_their_own():
    graph = joined([[5, 9], [3, 1]], ids=[1, 2, 3, 5, 9])
    assert_array_equal(graph.components, [0, 1, 0, 2, 2])
    assert_array_equal(graph.gauge, [1, 2, 5])


def test_the_gauge_is_the_fixed_nodes_and_the_smallest_id_of_each_other_component():
    graph = joined([[5, 9], [3, 1]], ids=[1, 2, 3, 5, 9], fixed=[9])
    assert_array_equal(graph.gauge, [1, 2, 9])


node_pairs = st.tuples(st.integers(0, 11), st.integers(0, 11)).filter(lambda e: e[0] != e[1])


@given(st.lists(node_pairs, max_size=12))
def test_components_are_those_of_merging_along_every_edge(edges):
    graph = joined(edges, ids=range(12))
    label = list(range(12))
    for a, b in edges:
        low, high = sorted((label[a], label[b]))
        label = [low if k == high else k for k in label]
    assert_array_equal(graph.components, np.unique(label, return_inverse=True)[1])
    assert_array_equal(graph.gauge, np.unique(label))


def test_repeated_edges_are_measurements_of_their_own():
    edges = [[0, 1], [1, 0], [0, 1]]
    graph = PoseGraph.from_arrays(edges, [[1, 0, 0], [2, 0, 0], [3, 0, 0]])
    assert_array_equal(graph.edges, edges)
    assert_array_equal(graph.measurements[:, 0], [1, 2, 3])


def test_index_gives_the_indices_of_ids_in_any_shape():
    graph = triangle()
    assert graph.index(20) == 1
    assert_array_equal(graph.index([[30, 10], [10, 10]]), [[2, 0], [0, 0]])
    assert graph.index([]).shape == (0,)


@pytest.mark.parametrize("ids", [11, [10, 11], 31, 9, LOWEST, HIGHEST])
def test_index_refuses_unknown_ids_by_name(ids):
    with pytest.raises(GraphError, match=f"no node {np.ravel(ids)[-1]}"):
        triangle().index(ids)


@pytest.mark.parametrize("ids", [10.0, [10.0], 2**63])
def test_index_takes_integers_only(ids):
    with pytest.raises(GraphError, match="ids must be integers"):
        triangle().index(ids)


def test_with_poses_changes_only_the_poses_of_a_copy():
    graph = triangle(poses=POSES, fixed=[20], information=np.diag([1, 2, 3]))
    moved = graph.with_poses(np.add(POSES, 1))
    assert_array_equal(moved.poses, np.add(POSES, 1))
    assert_array_equal(graph.poses, POSES)
    for name in ("ids", "edges", "measurements", "information", "fixed"):
        assert_array_equal(getattr(moved, name), getattr(graph, name))


def test_with_poses_copies_and_normalizes_what_it_is_given():
    given = spatial_with(0, [0, 0, 0.6, 0.8 + 1e-7])
    before = given.copy()
    graph = triangle(SPATIAL).with_poses(given)
    assert_array_equal(given, before)
    given[:] = 0
    assert_allclose(np.linalg.norm(graph.poses[:, 3:], axis=1), 1, rtol=0, atol=2.3e-16)
    with pytest.raises(ValueError, match="read-only"):
        graph.poses[:] = 0


def test_with_poses_keeps_the_components_found_before():
    graph = joined([[5, 9], [3, 1]])
    before = graph.components
    moved = graph.with_poses(np.zeros((4, 3)))
    assert_array_equal(moved.components, before)
    assert_array_equal(moved.edge_indices, [[2, 3], [1, 0]])


def test_notes_are_added_in_order_and_once():
    graph = triangle(notes=["read", "skipped"]).with_poses(POSES, notes=["bridged", "read"])
    assert graph.notes == ("read", "skipped", "bridged")
    assert graph.with_poses(POSES).notes == graph.notes


@pytest.mark.parametrize(
    ("base", "poses", "node", "message"),
    [
        (PLANAR, POSES[:2], None, r"shape \(2, 3\) do not fit"),
        (PLANAR, np.zeros((3, 7)), None, r"shape \(3, 7\) do not fit"),
        (SPATIAL, POSES, None, r"shape \(3, 3\) do not fit"),
        (PLANAR, "ab", None, "poses must be numbers"),
        (PLANAR, [[0, 0, 0], [0, np.nan, 0], [0, 0, 0]], 1, "pose of node 20 is not finite"),
        (SPATIAL, spatial_with(2, 0), 2, "pose of node 30 has a quaternion of length 0"),
    ],
)
def test_with_poses_refuses_what_fits_no_node(base, poses, node, message):
    with pytest.raises(GraphError, match=message) as caught:
        triangle(base).with_poses(poses)
    assert caught.value.node == node
