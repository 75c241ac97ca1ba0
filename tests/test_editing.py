from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from random_graphs import random_graph

import masat
from masat import GraphError, InformationError, PoseGraph, lie

LOWEST, HIGHEST = -(2**63), 2**63 - 1
STEP = [1, 0, 0]
QUARTER = np.pi / 2
ARRAYS = ("ids", "poses", "edges", "measurements", "information", "fixed", "labels")


def path(*ids, labels=None, poses=True, fixed=(), notes=()):
    """Return a straight path of steps of one meter over these ids."""
    edges = list(pairwise(ids))
    return PoseGraph.from_arrays(
        edges,
        [STEP] * len(edges),
        ids=ids,
        poses=[[k, 0, 0] for k in range(len(ids))] if poses else None,
        labels=labels,
        fixed=fixed,
        notes=notes,
    )


def assert_same(graph, other, but=()):
    for name in ARRAYS:
        if name not in but:
            assert_array_equal(getattr(graph, name), getattr(other, name), err_msg=name)
    assert graph.notes == other.notes
    assert_array_equal(graph.gauge, other.gauge)


graphs = st.builds(
    random_graph,
    st.sampled_from([2, 3]),
    st.integers(2, 12),
    st.integers(0, 8),
    seed=st.integers(0, 99),
    noise=st.just(0.1),
)


# with_edges


def test_new_edges_come_after_those_of_the_graph():
    graph = path(1, 2, 3, fixed=[2], notes=["a note"])
    more = graph.with_edges([[3, 1], [1, 3]], [[-2, 0, 0], [2, 0, 0]], np.diag([1, 2, 3]))
    assert more.edges.tolist() == [[1, 2], [2, 3], [3, 1], [1, 3]]
    assert more.measurements[2:].tolist() == [[-2, 0, 0], [2, 0, 0]]
    assert more.information[:, 2, 2].tolist() == [1, 1, 3, 3]
    assert_same(graph, more, but=("edges", "measurements", "information"))
    assert more.edge_indices.tolist() == [[0, 1], [1, 2], [2, 0], [0, 2]]
    assert graph.edges.tolist() == [[1, 2], [2, 3]]


def test_new_nodes_are_placed_by_the_measurements_from_the_nodes_that_were_there():
    graph = path(10, 20).with_poses([[5, 5, 0], [6, 5, QUARTER]])
    # 5 lies one meter ahead of 20, which looks to +y; 30 lies one meter to the left of 5.
    more = graph.with_edges([[20, 5], [30, 5]], [[1, 0, 0], [0, -1, 0]])
    assert more.ids.tolist() == [5, 10, 20, 30]
    expected = [[6, 6, QUARTER], [5, 5, 0], [6, 5, QUARTER], [5, 6, QUARTER]]
    assert_allclose(more.poses, expected, rtol=0, atol=1e-15)
    assert_array_equal(more.poses[1:3], graph.poses)
    assert more.chi2 == pytest.approx(graph.chi2)


def test_new_nodes_are_placed_along_the_fewest_edges_in_3d():
    truth = random_graph(3, 6, 0, seed=1, noise=0)
    graph = truth.without_nodes([4, 5])
    new = ~np.isin(truth.edges, graph.ids).all(axis=1)
    more = graph.with_edges(truth.edges[new], truth.measurements[new])
    assert_allclose(lie.local(truth.poses, more.poses), 0, atol=1e-12)


def test_new_nodes_keep_the_poses_that_are_given():
    graph = path(10, 20)
    edges, z = [[20, 5], [30, 5]], [STEP, STEP]
    ascending = graph.with_edges(edges, z, poses=[[1, 2, 0.5], [3, 4, 0.6]])
    assert ascending.poses.tolist() == [[1, 2, 0.5], [0, 0, 0], [1, 0, 0], [3, 4, 0.6]]
    named = graph.with_edges(edges, z, ids=[30, 5], poses=[[3, 4, 0.6], [1, 2, 0.5]])
    assert_same(ascending, named)


def test_new_nodes_of_a_graph_without_poses_have_none():
    more = path(1, 2, poses=False).with_edges([[2, 7]], [STEP])
    assert more.poses is None
    assert more.ids.tolist() == [1, 2, 7]


def test_nodes_without_edges_can_be_added_with_poses():
    more = path(1, 2).with_edges([], [], ids=[7, 5], poses=[[7, 7, 0], [5, 5, 0]])
    assert more.ids.tolist() == [1, 2, 5, 7]
    assert more.poses[2:].tolist() == [[5, 5, 0], [7, 7, 0]]
    assert more.gauge.tolist() == [1, 5, 7]


def test_adding_no_edge_changes_nothing():
    graph = path(1, 2, 3, labels=["a", "b"])
    assert_same(graph, graph.with_edges([], []))


@given(graphs, st.integers(0, 99))
def test_edges_that_are_added_and_removed_leave_the_same_graph(graph, seed):
    random = np.random.default_rng(seed)
    count = len(graph.edges)
    picked = random.integers(count, size=3)
    more = graph.with_edges(
        graph.edges[picked], graph.measurements[picked], graph.information[picked]
    )
    assert more.chi2 == pytest.approx(graph.chi2 + graph.chi2_per_edge[picked].sum())
    assert_same(graph, more.without_edges(range(count, count + 3)))
    mask = np.arange(count + 3) >= count
    assert_same(graph, more.without_edges(mask))


@given(graphs, st.data())
def test_edges_that_are_removed_and_added_again_leave_the_same_cost(graph, data):
    some = data.draw(st.sets(st.integers(0, len(graph.edges) - 1)))
    rest, again = graph.without_edges(some), sorted(some)
    assert rest.chi2 == pytest.approx(graph.chi2 - graph.chi2_per_edge[again].sum(), abs=1e-6)
    back = rest.with_edges(graph.edges[again], graph.measurements[again], graph.information[again])
    assert back.chi2 == pytest.approx(graph.chi2)
    assert_array_equal(back.poses, graph.poses)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"edges": [[1, 1]]}, "edge 0 joins node 1 to itself"),
        ({"edges": [1, 2]}, r"edges must have shape \(m, 2\)"),
        ({"edges": [[1, 9]], "ids": []}, r"edge 0 \(1 -> 9\) names node 9, which is not among"),
        ({"edges": [[1, 9]], "ids": [9, 2]}, "node 2 is in the graph already"),
        ({"edges": [[1, 9]], "ids": [9, 9]}, "the node id 9 occurs twice"),
        ({"edges": [[1, 9]], "ids": [[9]]}, r"ids must have shape \(n,\)"),
        ({"edges": [[8, 9]]}, "no edges lead from the nodes of the graph to the new node 8"),
        ({"edges": [[1, 9]], "poses": [[0, 0]]}, r"poses must have shape \(1, 3\)"),
        ({"edges": [[1, 2]], "poses": [STEP]}, r"poses must have shape \(0, 3\)"),
        ({"edges": [[1, 9]], "poses": [[0, 0, np.nan]]}, "pose of node 9 is not finite"),
        ({"measurements": [STEP] * 2}, r"measurements must have shape \(1, 3\)"),
        ({"measurements": [[0, 0, 0, 0, 0, 0, 1]]}, r"measurements must have shape \(1, 3\)"),
        ({"measurements": [[0, 0, np.inf]]}, r"measurement of edge 0 \(1 -> 2\) is not finite"),
        ({"information": np.eye(6)}, r"information must have shape \(1, 3, 3\)"),
        ({"information": -np.eye(3)}, "not positive semidefinite"),
        ({"labels": ["a", "b"]}, r"labels must have shape \(1,\)"),
    ],
)
def test_new_edges_are_checked(more, message):
    with pytest.raises(GraphError, match=message):
        path(1, 2, 3).with_edges(**({"edges": [[1, 2]], "measurements": [STEP]} | more))


def test_poses_of_new_nodes_are_refused_where_the_graph_has_none():
    with pytest.raises(GraphError, match="the graph has no poses, so its new nodes can have none"):
        path(1, 2, poses=False).with_edges([[2, 3]], [STEP], poses=[STEP])


def test_old_edges_are_not_checked_again(monkeypatch):
    graph = random_graph(3, 40, 30, seed=2)
    counted = []
    real = masat._checks.not_semidefinite
    monkeypatch.setattr(
        masat._checks, "not_semidefinite", lambda w: counted.append(len(w)) or real(w)
    )
    graph.with_edges(graph.edges[:2], graph.measurements[:2], graph.information[:2])
    graph.without_edges([0]).without_nodes([3]).relabel(5).with_fixed([9, 10])
    masat.merge([graph, graph])
    assert counted == [2]


def test_two_fixed_nodes_that_new_edges_join_need_poses():
    graph = path(0, 1, poses=False).with_edges([[2, 3]], [STEP]).with_fixed([0, 3])
    with pytest.raises(GraphError, match="several fixed nodes of one component need poses"):
        graph.with_edges([[1, 2]], [STEP])


def test_a_chosen_root_survives_editing():
    graph = path(0, 1, 2, 3).with_root(2)
    assert graph.with_edges([[3, 4]], [STEP]).gauge.tolist() == [2]
    assert graph.without_edges([0]).gauge.tolist() == [0, 2]
    assert graph.without_nodes([0]).gauge.tolist() == [2]
    assert graph.without_nodes([2]).gauge.tolist() == [0, 3]
    assert graph.relabel(10).gauge.tolist() == [12]
    assert graph.with_fixed([]).gauge.tolist() == [2]
    assert graph.with_fixed(3).gauge.tolist() == [3]
    assert masat.merge([path(0, 1), graph]).gauge.tolist() == [0, 1_000_002]


# without_edges, without_nodes


def test_nodes_that_lose_all_their_edges_remain():
    graph = path(1, 2, 3, labels=["a", "b"]).without_edges(1)
    assert graph.ids.tolist() == [1, 2, 3]
    assert graph.edges.tolist() == [[1, 2]]
    assert graph.labels.tolist() == ["a"]
    assert graph.gauge.tolist() == [1, 3]
    assert graph.without_edges([0]).edges.shape == (0, 2)


@pytest.mark.parametrize("none", [[], (), np.zeros(2, bool), np.zeros(0, np.int64), set()])
def test_removing_no_edge_changes_nothing(none):
    graph = path(1, 2, 3)
    assert_same(graph, graph.without_edges(none))


@pytest.mark.parametrize(
    ("which", "message"),
    [
        (2, "there is no edge 2: the graph has 2 edges"),
        (-1, "there is no edge -1"),
        ([True], r"a mask of edges must have shape \(2,\), got \(1,\)"),
        ([True, False, True], r"a mask of edges must have shape \(2,\), got \(3,\)"),
        ([0.5], "must be integers .* float64"),
        ("a", "must be integers"),
        ([[0], [0, 1]], "row 1 is not as long"),
    ],
)
def test_edges_that_do_not_exist_cannot_be_removed(which, message):
    with pytest.raises(GraphError, match=message):
        path(1, 2, 3).without_edges(which)


def test_a_removed_node_takes_its_edges_along():
    graph = path(1, 2, 3, 4, labels=[7, 8, 9], fixed=[2, 4], notes=["a note"]).without_nodes(2)
    assert graph.ids.tolist() == [1, 3, 4]
    assert graph.poses[:, 0].tolist() == [0, 2, 3]
    assert graph.edges.tolist() == [[3, 4]]
    assert graph.labels.tolist() == [9]
    assert graph.fixed.tolist() == [4]
    assert graph.notes == ("a note",)
    assert_same(graph, graph.without_nodes([]))


@pytest.mark.parametrize(
    ("ids", "message"),
    [(9, "no node 9"), ([1, 2, 3], "not all nodes can be removed"), (1.0, "ids must be integers")],
)
def test_nodes_that_cannot_be_removed_are_refused(ids, message):
    with pytest.raises(GraphError, match=message):
        path(1, 2, 3).without_nodes(ids)


# with_fixed


@pytest.mark.parametrize("fixed", [3, [3], np.int64(3), np.array([3, 3]), {3}, (3,), iter([3])])
def test_fixed_nodes_are_replaced(fixed):
    graph = path(1, 2, 3, fixed=[1])
    changed = graph.with_fixed(fixed)
    assert changed.fixed.tolist() == changed.gauge.tolist() == [3]
    assert changed.topology is graph.topology
    assert changed.elimination.free_nodes().tolist() == [0, 1]
    assert graph.elimination.free_nodes().tolist() == [1, 2]
    assert changed.with_fixed([]).gauge.tolist() == [1]


def test_one_fixed_node_can_be_given_as_an_integer():
    assert path(1, 2, fixed=2).fixed.tolist() == [2]


@pytest.mark.parametrize(
    ("fixed", "message"),
    [
        (9, "the fixed node 9 is not in the graph"),
        (1.0, "fixed must be integers .* float64"),
        (True, "fixed must be integers .* booleans"),
        (None, "fixed must be integers .* None"),
        ("12", "fixed must be integers .* strings"),
        ([1, None], "fixed must be integers"),
        ([[1, 2]], r"fixed must be integers in one row, got shape \(1, 2\)"),
        (np.nan, "fixed must be integers"),
        (2**63, "fixed must be integers"),
    ],
)
def test_what_fixes_no_node_is_refused(fixed, message):
    with pytest.raises(GraphError, match=message):
        path(1, 2, 3).with_fixed(fixed)
    with pytest.raises(GraphError, match=message):
        path(1, 2, 3, fixed=fixed)


def test_several_fixed_nodes_need_poses():
    with pytest.raises(GraphError, match="several fixed nodes of one component need poses"):
        path(1, 2, poses=False).with_fixed([1, 2])


# relabel


def test_ids_are_shifted_mapped_or_computed():
    graph = path(1, 2, 3, labels=["a", "b"], fixed=2, notes=["a note"])
    for to in (10, np.int32(10), {1: 11, 2: 12, 3: 13}, lambda k: k + 10):
        moved = graph.relabel(to)
        assert moved.ids.tolist() == [11, 12, 13]
        assert moved.edges.tolist() == [[11, 12], [12, 13]]
        assert moved.fixed.tolist() == moved.gauge.tolist() == [12]
        assert moved.topology is graph.topology
        assert_same(graph, moved.relabel(-10))


def test_poses_and_edges_follow_ids_that_change_their_order():
    graph = path(1, 2, 3, fixed=2)
    swapped = graph.relabel({1: 3, 3: 1})
    assert swapped.ids.tolist() == [1, 2, 3]
    assert swapped.edges.tolist() == [[3, 2], [2, 1]]
    assert swapped.poses[:, 0].tolist() == [2, 1, 0]
    assert swapped.edge_indices.tolist() == [[2, 1], [1, 0]]
    assert swapped.chi2 == graph.chi2 == 0


@given(graphs, st.data())
def test_ids_that_change_and_change_back_leave_the_same_graph(graph, data):
    count = len(graph)
    new = data.draw(
        st.lists(st.integers(LOWEST, HIGHEST), min_size=count, max_size=count, unique=True)
    )
    there = dict(zip(graph.ids.tolist(), new, strict=True))
    back = {b: a for a, b in there.items()}
    moved = graph.relabel(there)
    assert moved.ids.tolist() == sorted(new)
    assert_allclose(moved.chi2_per_edge, graph.chi2_per_edge, rtol=1e-12)
    assert_same(graph, moved.relabel(back.get))


@pytest.mark.parametrize(
    ("to", "message"),
    [
        ({1: 2}, "the nodes 1 and 2 would both get the id 2"),
        (lambda k: 0, "the nodes 1 and 2 would both get the id 0"),
        ({9: 10}, "the graph has no node 9"),
        ({"a": 10}, "ids must be integers"),
        ({1: 1.5}, "new ids must be integers"),
        ({1: 2**63}, "new ids must be integers"),
        (lambda k: str(k), "new ids must be integers"),
        (lambda k: (k, k), "new ids must be one integer for each node"),
        (lambda k: None, "new ids must be integers"),
        (0.5, "an offset of ids must be an integer, got 0.5"),
        (True, "an offset of ids must be an integer, got True"),
        ("a", "an offset of ids must be an integer, got 'a'"),
        (HIGHEST, f"ids 1 to 3 shifted by {HIGHEST} do not fit in 64 bits"),
    ],
)
def test_new_ids_must_be_distinct_integers(to, message):
    with pytest.raises(GraphError, match=message):
        path(1, 2, 3).relabel(to)


def test_an_offset_of_more_than_64_bits_is_taken_where_its_sums_fit():
    graph = path(LOWEST, LOWEST + 1).relabel(2**64 - 2)
    assert graph.ids.tolist() == [HIGHEST - 1, HIGHEST]
    assert graph.relabel(-(2**64) + 2).ids.tolist() == [LOWEST, LOWEST + 1]


# labels


@pytest.mark.parametrize(
    ("labels", "expected"),
    [
        ([3, -1], np.array([3, -1])),
        (np.array([3, 255], np.uint8), np.array([3, 255])),
        (["odometry", "gps"], np.array(["odometry", "gps"])),
        (np.array(["a", "b"], "U500"), np.array(["a", "b"])),
        (np.array(["a", "b"], ">U2"), np.array(["a", "b"])),
        (np.array(["a", "b"])[::-1], np.array(["b", "a"])),
        ("gps", np.array(["gps", "gps"])),
        (4, np.array([4, 4])),
        (["Übergang 1", ""], np.array(["Übergang 1", ""])),
        (["x" * 64, "x"], np.array(["x" * 64, "x"])),
    ],
)
def test_labels_are_integers_or_short_strings(labels, expected):
    graph = path(1, 2, 3, labels=labels)
    assert_array_equal(graph.labels, expected)
    assert graph.labels.dtype == expected.dtype


def test_edges_have_no_labels_unless_they_are_given():
    assert path(1, 2).labels is None


@pytest.mark.parametrize(
    ("labels", "message"),
    [
        (["a"], r"labels must have shape \(2,\) or be one label, got \(1,\)"),
        ([["a", "b"]], r"labels must have shape \(2,\)"),
        (["a", 1], "labels must be all integers or all strings"),
        (["a", None], "labels must be integers or strings, got an object such as 'a'"),
        ([0.5, 1], "labels must be integers or strings, got float64"),
        ([True, False], "labels must be integers or strings, got booleans"),
        ([b"a", b"b"], "labels must be integers or strings, got bytes"),
        ([1, 2**63], "labels must be integers"),
        (["a", "x" * 65], "label of edge 1 has 65 characters: at most 64"),
        (["a", "b\n"], "label of edge 1, 'b.n', holds a control character or a line break"),
        (["\x85", "b"], "label of edge 0, .* holds a control character"),
        (["a", "b\u2028c"], "label of edge 1, .* holds a control character"),
        (["a\0b", "c"], "label of edge 0, .* holds a control character"),
        (["a", "\ud800"], "label of edge 1, .* holds a control character"),
        (np.ma.array([1, 2], mask=[0, 1]), "row 1 of labels is masked"),
    ],
)
def test_labels_that_no_file_could_hold_are_refused(labels, message):
    with pytest.raises(GraphError, match=message):
        path(1, 2, 3, labels=labels)


def test_labels_follow_their_edges():
    graph = path(1, 2, 3, labels=["a", "bb"])
    more = graph.with_edges([[3, 1]], [STEP], labels="loop closure")
    assert more.labels.tolist() == ["a", "bb", "loop closure"]
    assert more.without_edges(0).labels.tolist() == ["bb", "loop closure"]
    assert more.relabel({1: 3, 3: 1}).labels is more.labels
    assert more.with_fixed(1).labels is more.with_poses(more.poses).labels is more.labels
    assert masat.merge([graph, more]).labels.tolist() == ["a", "bb", *more.labels.tolist()]


def test_edges_without_labels_get_empty_ones_among_others_that_have_some():
    new = {"edges": [[3, 1]], "measurements": [STEP]}
    assert path(1, 2, 3, labels=["a", "b"]).with_edges(**new).labels.tolist() == ["a", "b", ""]
    assert path(1, 2, 3, labels=[5, 6]).with_edges(**new).labels.tolist() == [5, 6, -1]
    assert path(1, 2, 3).with_edges(**new, labels=["c"]).labels.tolist() == ["", "", "c"]
    assert masat.merge([path(1, 2), path(1, 2, labels=[5])]).labels.tolist() == [-1, 5]
    with pytest.raises(GraphError, match="labels must be all integers or all strings"):
        path(1, 2, 3, labels=[5, 6]).with_edges(**new, labels=["c"])


# merge


def test_ids_of_merged_graphs_tell_the_graph():
    merged = masat.merge([path(3, 4, 9), path(0, 1, 5, fixed=5), path(-7, 2)])
    a, b = 10**6, 2 * 10**6
    assert merged.ids.tolist() == [3, 4, 9, a, a + 1, a + 5, b - 7, b + 2]
    assert merged.edges.tolist() == [[3, 4], [4, 9], [a, a + 1], [a + 1, a + 5], [b - 7, b + 2]]
    assert merged.poses[:, 0].tolist() == [0, 1, 2, 0, 1, 2, 0, 1]
    assert merged.gauge.tolist() == [3, a + 5, b - 7]
    assert masat.sessions(merged).tolist() == [0, 0, 0, 1, 1, 1, 2, 2]


def test_merged_graphs_are_joined_by_the_edges_between_them():
    a, b = path(0, 1, 2), path(0, 1)
    shift = 10**6
    merged = masat.merge([a, b], ([[2, 0 + shift]], [STEP], np.eye(3) * 4))
    assert merged.edges.tolist() == [[0, 1], [1, 2], [shift, shift + 1], [2, shift]]
    assert_same(merged, masat.merge([a, b], ([[0, 2, 1, 0]], [STEP], np.eye(3) * 4)))
    assert merged.information[:, 0, 0].tolist() == [1, 1, 1, 4]
    assert merged.gauge.tolist() == [0]
    result = masat.optimize(merged)
    assert result.chi2 == pytest.approx(0, abs=1e-20)
    assert_allclose(result.poses, [[k, 0, 0] for k in range(5)], atol=1e-9)


def test_poses_are_kept_if_all_merged_graphs_have_some():
    a, b = path(0, 1, notes=["read", "a"]), path(0, 1, notes=["read", "b"])
    frames = "the poses of 2 merged graphs are each in the frame of their own graph"
    assert masat.merge([a, b]).notes == ("read", "a", "b", frames)
    fixed = masat.merge([a.with_fixed(0), b.with_fixed(1)])
    assert fixed.notes[-1].startswith(frames + "; so are the fixed nodes")
    assert fixed.fixed.tolist() == [0, 1_000_001]
    without = masat.merge([a, path(0, 1, poses=False)])
    assert without.poses is None
    assert without.notes[-1] == "the merged graph has no poses, since graph 1 has none"
    assert masat.merge([path(0, 1, poses=False)] * 2).notes == ()


def test_one_graph_merged_is_itself():
    graph = path(5, 6, labels=["a"], notes=["a note"])
    assert_same(graph, masat.merge([graph]))


@given(graphs, st.data())
def test_a_graph_that_is_cut_and_merged_costs_the_same(graph, data):
    some = data.draw(st.sets(st.sampled_from(graph.ids.tolist()), min_size=1))
    rest = sorted(set(graph.ids.tolist()) - some)
    parts = [graph.without_nodes(rest), graph.without_nodes(some)] if rest else [graph]
    cut = np.isin(graph.edges, sorted(some)).sum(axis=1) == 1
    between = graph.edges[cut], graph.measurements[cut], graph.information[cut]
    merged = masat.merge(iter(parts), between, offsets=[0] * len(parts), common_frame=True)
    assert_array_equal(merged.ids, graph.ids)
    assert_array_equal(merged.poses, graph.poses)
    assert_array_equal(merged.gauge, graph.gauge)
    assert merged.chi2 == pytest.approx(graph.chi2)


@given(st.lists(st.sets(st.integers(-50, 50), min_size=1), min_size=1, max_size=5))
def test_shifted_ids_never_meet(sessions):
    parts = [PoseGraph.from_arrays([], [], ids=sorted(ids)) for ids in sessions]
    merged = masat.merge(parts)
    assert len(merged) == sum(map(len, parts))
    shifts = [int(p.ids[0]) for p in parts]
    start = 0
    for part, shift in zip(parts, shifts, strict=True):
        own = merged.ids[start : start + len(part)]
        assert_array_equal(own - own[0], part.ids - shift)
        start += len(part)


SPATIAL = PoseGraph.from_arrays([[0, 1]], [[0, 0, 0, 0, 0, 0, 1]])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([],), "there is no graph to merge"),
        ((path(0, 1),), "give the graphs to merge as a list"),
        (([path(0, 1), SPATIAL],), "graph 0 is in 2D but graph 1 is in 3D"),
        (([path(0, 1), "b"],), "graph 1 is no PoseGraph but of type str"),
        (([path(0, 1), path(2, HIGHEST), path(0, 1)],), "do not fit in 64 bits"),
        (([path(0, 1)] * 2, ([[1, 2]],)), "`between` must be"),
        (([path(0, 1)] * 2, ([[1, 4]], [STEP])), r"edge 0 \(1 -> 4\) names node 4"),
        (([path(0, 1)] * 2, ([[1, 10**6]], [STEP], -np.eye(3))), "not positive semidefinite"),
    ],
)
def test_what_cannot_be_merged_is_refused(arguments, message):
    with pytest.raises(GraphError, match=message):
        masat.merge(*arguments)


@pytest.mark.parametrize(
    ("offsets", "message"),
    [
        ([0, 0, 0], "the graphs 0 and 1 both have a node 1: choose other offsets"),
        ([0, 5, -2], "the graphs 0 and 2 both have a node 0"),
        ([0, 5, 6], "the graphs 1 and 2 both have a node 7"),
        ([0, 5], r"offsets must be 3 integers, one a graph, got \[0, 5\]"),
        ([0, 0.5, 1], "offsets must be integers"),
        (7, "offsets must be 3 integers"),
    ],
)
def test_ids_that_meet_under_given_offsets_are_refused_by_name(offsets, message):
    with pytest.raises(GraphError, match=message):
        masat.merge([path(0, 1), path(1, 2), path(1, 2)], offsets=offsets)


def test_given_offsets_may_interleave_the_graphs():
    merged = masat.merge([path(0, 4), path(0, 4)], offsets=[0, 2])
    assert merged.ids.tolist() == [0, 2, 4, 6]
    assert merged.poses[:, 0].tolist() == [0, 0, 1, 1]


def test_a_bad_matrix_among_new_edges_is_counted_among_them():
    with pytest.raises(InformationError, match=r"of 1 of 2 edges .* edge 1") as caught:
        path(1, 2, 3).with_edges([[1, 2], [2, 3]], [STEP] * 2, [np.eye(3), -np.eye(3)])
    assert (caught.value.edge, caught.value.count) == (1, 1)


# size and cost


def test_the_length_is_the_number_of_nodes():
    graph = path(1, 2, 3)
    assert len(graph) == 3
    assert graph


def test_chi2_is_that_of_the_own_poses():
    graph = path(1, 2, 3).with_edges([[1, 3]], [[2.5, 0, 0]], np.diag([4, 1, 1]))
    assert graph.chi2_per_edge.tolist() == [0, 0, 1]
    assert graph.chi2 == 1
    assert graph.chi2_per_edge is graph.chi2_per_edge
    moved = graph.with_poses([[0, 0, 0], [1, 0, 0], [3, 0, 0]])
    assert moved.chi2_per_edge.tolist() == [0, 1, 1]
    assert PoseGraph.from_arrays([], [], ids=[1], poses=[STEP]).chi2 == 0


def test_chi2_without_poses_is_refused():
    with pytest.raises(GraphError, match="the graph has no poses"):
        _ = path(1, 2, poses=False).chi2
