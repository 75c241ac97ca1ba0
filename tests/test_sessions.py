"""Sessions: merging with links, the ids that tell them apart, false links, and `masat merge`."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

import masat
from masat import FormatError, GraphError, PoseGraph, lie
from masat.chain import odometry_edges
from masat.robust.closures import Closures
from masat.robust.parts import joining_closures
from masat.worlds import add_false_closures, manhattan, normalized, perturb, sphere

STEP = (1.0, 0, 0)


def walk(n, *, fixed=(), first=0):
    pairs = [(first + k, first + k + 1) for k in range(n - 1)]
    poses = [(k, 0, 0) for k in range(n)]
    return PoseGraph.from_arrays(pairs, [STEP] * (n - 1), poses=poses, fixed=fixed)


def cut(graph, count, seed=0):
    """Sessions with ids from zero and a random frame each, and the edges between them as links."""
    rng = np.random.default_rng(seed)
    of = np.arange(len(graph)) * count // len(graph)
    first = np.searchsorted(of, np.arange(count))
    ends = of[graph.edge_indices]
    across = ends[:, 0] != ends[:, 1]
    parts = []
    for k in range(count):
        part = graph.without_nodes(graph.ids[of != k])
        part = part.relabel({int(node): i for i, node in enumerate(part.ids)})
        frame = lie.retract(lie.identity(graph.dimension), rng.normal(size=graph.dof))
        parts.append(part.with_poses(lie.compose(frame, part.poses)))
    rows = np.empty((across.sum(), 4), np.int64)
    rows[:, 0::2] = ends[across]
    rows[:, 1::2] = graph.edge_indices[across] - first[ends[across]]
    return parts, (rows, graph.measurements[across], graph.information[across])


def clean(world, nodes):
    graph = perturb(world(nodes, seed=1), [0.03] * (3 if world is manhattan else 6), seed=1)
    return normalized(masat.solve(graph).graph)


# --- ids and links ---


def test_ids_tell_the_session():
    merged = masat.merge([walk(3), walk(4), walk(2)])
    assert merged.ids.tolist() == [0, 1, 2, *range(10**6, 10**6 + 4), 2 * 10**6, 2 * 10**6 + 1]
    assert masat.sessions(merged).tolist() == [0, 0, 0, 1, 1, 1, 1, 2, 2]


def test_the_shift_is_ten_times_the_largest_id():
    merged = masat.merge([walk(2), walk(2, first=250_000)])
    assert merged.ids.tolist() == [0, 1, 10_250_000, 10_250_001]
    again = masat.merge([merged, walk(2)])
    assert again.ids[-2:].tolist() == [10**9, 10**9 + 1]
    assert masat.sessions(again).tolist() == [0, 0, 1, 1, 2, 2]


def test_ids_that_are_times_follow_each_other():
    first = 1_700_000_000_000_000_000
    stamped = PoseGraph.from_arrays([(first, first + 10**8)], [STEP])
    merged = masat.merge([stamped, walk(3), stamped])
    assert masat.sessions(merged).tolist() == [0, 0, 1, 1, 1, 2, 2]


@given(st.lists(st.sets(st.integers(-900, 900), min_size=3), min_size=1, max_size=5))
def test_sessions_are_found_again(ids):
    parts = [PoseGraph.from_arrays([], [], ids=sorted(own)) for own in ids]
    merged = masat.merge(parts)
    expected = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
    assert_array_equal(masat.sessions(merged), expected)


def test_the_sessions_survive_a_file(tmp_path):
    merged = masat.merge([walk(3), walk(4)], ([(0, 2, 1, 0)], [STEP]))
    masat.write(merged, tmp_path / "merged.g2o")
    again = masat.read(tmp_path / "merged.g2o")
    assert masat.sessions(again).tolist() == [0, 0, 0, 1, 1, 1, 1]


def test_the_ids_of_one_session_may_have_gaps():
    ids = [0, 5, 7, 300, 301, 10_000]
    assert masat.sessions(PoseGraph.from_arrays([], [], ids=ids)).tolist() == [0] * 6
    letters = [ord("a") << 56 | k for k in range(3)] + [ord("b") << 56 | k for k in range(2)]
    assert masat.sessions(PoseGraph.from_arrays([], [], ids=letters)).tolist() == [0, 0, 0, 1, 1]


def test_a_link_from_the_last_node_to_the_first_is_no_odometry():
    merged = masat.merge([walk(3), walk(3)], ([(0, 2, 1, 0)], [STEP]))
    assert odometry_edges(merged).tolist() == [True] * 4 + [False]


def test_links_by_session_are_those_by_merged_id():
    ends, measured = [(0, 2, 1, 0), (1, 1, 0, 0)], [STEP, (-4, 0, 0)]
    by_session = masat.merge([walk(3), walk(3)], (ends, measured))
    by_id = masat.merge([walk(3), walk(3)], ([(2, 10**6), (10**6 + 1, 0)], measured))
    as_graph = PoseGraph.from_arrays([(2, 10**6), (10**6 + 1, 0)], measured, labels="link")
    by_graph = masat.merge([walk(3), walk(3)], as_graph)
    for other in (by_id, by_graph):
        assert_array_equal(by_session.edges, other.edges)
        assert_array_equal(by_session.measurements, other.measurements)
    assert by_graph.labels.tolist() == ["", "", "", "", "link", "link"]


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ((0, 2, 2, 0), "link 1 names graph 2, but there are 2, counted from 0"),
        ((-1, 2, 1, 0), "link 1 names graph -1"),
        ((0, 3, 1, 0), "link 1 names node 3 of graph 0, which has no such id"),
        ((0, 0, 1, 7), "link 1 names node 7 of graph 1"),
    ],
)
def test_links_to_nowhere_are_refused(row, message):
    with pytest.raises(GraphError, match=message):
        masat.merge([walk(3), walk(3)], ([(0, 0, 1, 0), row], [STEP] * 2))


def test_what_no_link_connects_is_said():
    merged = masat.merge([walk(2)] * 4, ([(0, 0, 2, 0)], [STEP]))
    assert "no links connect these maps" in merged.notes[-1]
    assert merged.notes[-1].endswith("graphs 0, 2; 1; 3")
    assert merged.components.tolist() == [0, 0, 1, 1, 0, 0, 2, 2]
    with pytest.warns(masat.MasatWarning, match="3 components"):
        assert len(masat.solve(merged).gauge) == 3


def test_linked_sessions_start_in_frames_of_their_own():
    sessions = [walk(3, fixed=0), walk(3, fixed=2), walk(2, fixed=1)]
    links = [(0, 2, 1, 0)], [(1, 0, np.pi / 2)]
    merged = masat.merge(sessions, links)
    assert merged.fixed.tolist() == [0, 2 * 10**6 + 1]
    assert "the fixed nodes of graphs 1 are fixed no longer" in merged.notes[-1]
    with pytest.warns(masat.MasatWarning, match="2 components"):
        result = masat.solve(merged)
    assert result.chi2 < 1e-20
    assert_allclose(result.poses[3:6, :2], [(3, 0), (3, 1), (3, 2)], atol=1e-9)
    common = masat.merge(sessions, links, common_frame=True)
    assert common.fixed.tolist() == [0, 10**6 + 2, 2 * 10**6 + 1]


def fixed_with_gps(n, *, y):
    """Return a session along x at this y in the world's frame, with a fixed node and two fixes."""
    poses = [(k, y, 0) for k in range(n)]
    ends = [poses[1][:2], poses[-1][:2]]
    return walk(n, fixed=0).with_poses(poses).with_priors(masat.gps([1, n - 1], ends, 0.1))


@pytest.mark.parametrize("links", [None, ([(0, 2, 1, 0)], [(-2, 5, 0)])])
def test_sessions_with_fixes_share_the_frame_of_the_world(links):
    merged = masat.merge([fixed_with_gps(3, y=0), fixed_with_gps(4, y=5)], links)
    assert merged.fixed.tolist() == [0, 10**6]
    assert not any("fixed no longer" in note for note in merged.notes)
    assert not any("so are the fixed nodes" in note for note in merged.notes)
    result = masat.solve(merged)
    assert result.chi2 < 1e-20
    expected = [(k, 0, 0) for k in range(3)] + [(k, 5, 0) for k in range(4)]
    assert_allclose(result.poses, expected, atol=1e-9)


@pytest.mark.parametrize("first", [True, False])
def test_fixed_nodes_in_a_frame_of_their_own_do_not_contradict_the_fixes_of_others(first):
    away = walk(3, fixed=0)  # fixed at the origin of its own frame
    located = walk(3).with_priors(masat.gps([0, 2], [(100, 50), (100, 52)], 0.1))
    parts = [away, located] if first else [located, away]
    own, other = (0, 1) if first else (1, 0)
    merged = masat.merge(parts, ([(other, 2, own, 0)], [STEP]))
    assert merged.fixed.tolist() == []
    assert f"the fixed nodes of graphs {own} are fixed no longer" in merged.notes[-1]
    result = masat.solve(merged)
    assert result.chi2 < 1e-15
    found = result.poses[masat.sessions(merged) == own, :2]
    assert_allclose(found, [(100, 53), (100, 54), (100, 55)], atol=1e-6)


def test_fixed_nodes_of_sessions_without_poses_are_merged():
    # As in files that have FIX and edges alone.
    parts = [PoseGraph.from_arrays(p.edges, p.measurements, fixed=0) for p in (walk(3), walk(2))]
    links = [(0, 2, 1, 0)], [STEP]
    assert masat.merge(parts).fixed.tolist() == [0, 10**6]
    assert masat.merge(parts, links).fixed.tolist() == [0]
    with pytest.raises(GraphError, match="several fixed nodes of one component need poses"):
        masat.merge(parts, links, common_frame=True)


@pytest.mark.parametrize(
    ("linked", "fixed"), [(True, [0]), (False, [0, 10**6])], ids=["linked", "apart"]
)
def test_headings_do_not_put_a_session_into_the_frame_of_the_world(linked, fixed):
    session = walk(3, fixed=0).with_priors(masat.headings([1], [0.0], 0.1))
    merged = masat.merge([session, session], ([(0, 2, 1, 0)], [STEP]) if linked else None)
    assert merged.fixed.tolist() == fixed
    result = masat.solve(merged)
    assert result.chi2 < 1e-20
    assert result.poses[3] == pytest.approx((3 if linked else 0, 0, 0))


# --- maps of sessions ---


@pytest.mark.parametrize("count", [2, 4, 8])
@pytest.mark.parametrize(("world", "nodes"), [(manhattan, 600), (sphere, 400)])
def test_a_cut_graph_has_the_same_optimum(world, nodes, count):
    graph = clean(world, nodes)
    merged = masat.merge(*cut(graph, count))
    assert masat.solve(merged).chi2 == pytest.approx(masat.solve(graph).chi2, rel=1e-9)


# Runs of 20 that agree are undecidable where there are no more true links.
@pytest.mark.parametrize(
    ("kind", "count"),
    [("random", 2), ("random", 4), ("grouped", 2), ("grouped", 4), ("alias", 2)],
)
@pytest.mark.parametrize(("world", "nodes"), [(manhattan, 600), (sphere, 400)])
def test_false_links_change_nothing(world, nodes, count, kind):
    graph = clean(world, nodes)
    parts, (ends, measured, information) = cut(graph, count)
    bad, is_false = add_false_closures(graph, kind, 0.5, seed=2)
    of = np.arange(nodes) * count // nodes
    false = np.flatnonzero(is_false & (np.diff(of[bad.edge_indices], axis=1)[:, 0] != 0))
    false = false[: round(0.3 / 0.7 * len(ends))]
    first = np.searchsorted(of, np.arange(count))
    indices = bad.edge_indices[false]
    rows = np.empty((len(false), 4), np.int64)
    rows[:, 0::2], rows[:, 1::2] = of[indices], indices - first[of[indices]]
    links = (
        np.concatenate([ends, rows]),
        np.concatenate([measured, bad.measurements[false]]),
        np.concatenate([information, bad.information[false]]),
    )
    result = masat.solve(masat.merge(parts, links), robust=True)
    assert not result.kept[-len(false) :].any()
    assert result.kept[: -len(false)].mean() > 0.99
    clean_chi2 = masat.optimize(masat.merge(parts, (ends, measured, information)).with_poses(
        result.poses
    )).chi2  # fmt: skip
    assert clean_chi2 == pytest.approx(graph.chi2, rel=1e-6)


def test_the_closure_that_others_far_away_confirm_joins_two_parts():
    # Three true links far apart against a false one; in the list the false one comes first.
    links = [(0, 5, 1, 40), (0, 2, 1, 2), (0, 50, 1, 50), (0, 97, 1, 97)]
    measured = [STEP, (0, 1, 0), (0, 1, 0), (0, 1, 0)]
    information = np.diag([100.0, 100, 10_000])
    parts = [walk(100), walk(100)]
    graph = masat.merge(
        [PoseGraph.from_arrays(p.edges, p.measurements, information) for p in parts],
        (links, measured, information),
    )
    (joining,) = joining_closures(Closures(graph))
    assert joining - 198 in (1, 2, 3)
    assert masat.solve(graph, robust=True).kept[-4:].tolist() == [False, True, True, True]


# --- files of links and the command ---


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_table_of_links_is_read(tmp_path, dimension):
    dof, size = lie.DOF[dimension], lie.POSE_SIZE[dimension]
    pose = np.array([1.0, 2, 3, 0.1, 0.3, 0.3, 0.9])[:size]
    # Different numbers, and a diagonal that dominates.
    upper = (np.arange(dof * dof).reshape(dof, dof) + 100 * dof * np.eye(dof))[np.triu_indices(dof)]
    row = " ".join(map(str, [0, 12, 1, -3, *pose, *upper]))
    path = tmp_path / "links.txt"
    path.write_text(f"# from the front end\n\n{row}  # one\n{row}\n")
    ends, measured, information = masat.read_links(path)
    assert ends.tolist() == [[0, 12, 1, -3]] * 2
    assert_array_equal(measured, [pose] * 2)
    assert_array_equal(information[1], information[1].T)
    assert_array_equal(information[1][np.triu_indices(dof)], upper)
    path.write_text(" ".join(map(str, [0, 12, 1, -3, *pose])))
    assert_array_equal(masat.read_links(path)[2], [np.eye(dof)])


@pytest.mark.parametrize(
    ("text", "line", "message"),
    [
        ("", None, "the file holds no links"),
        ("# nothing\n", None, "the file holds no links"),
        ("0 1 1 2 0.5\n", 1, "5 numbers; expected session, id, session, id, then a pose"),
        ("0 1 1 2 1 0 0\n0 1 1 2 1 0\n", 2, "6 numbers, but the first link has 7"),
        ("0 1 1 x 1 0 0\n", 1, "'x' is no session or id"),
        ("0 1 1 2.5 1 0 0\n", 1, "'2.5' is no session or id"),
        ("0 1 1 2 1 zero 0\n", 1, "expected numbers after session, id, session, id"),
        ("0 1 1 1_0 1 0 0\n", 1, "'1_0' is no session or id"),
        (f"0 {'9' * 5000} 1 2 1 0 0\n", 1, "is no session or id"),
        ("0 1 1 2 1 1_0 0\n", 1, "'1_0' is no finite number"),
        ("0 1 1 2 1 0 0\n\n0 1 1 2 nan 0 0\n", 3, "'nan' is no finite number"),
        ("0 1 1 2 1 0 0\n\n0 1 1 2 1 1e999 0\n", 3, "'1e999' is no finite number"),
        ("0 1 1 2 1 0 0 1 0 0 1 0 1\n0 1 1 2 1 0 0 1 0 0 -1 0 1\n", 2, "eigenvalue -1"),
        ("\n0 1 1 2 1 0 0 0 0 0 2\n", 2, "quaternion of length 2"),
    ],
)
def test_a_bad_table_of_links_is_refused(tmp_path, text, line, message):
    path = tmp_path / "links.txt"
    path.write_text(text)
    with pytest.raises(FormatError, match=message) as caught:
        masat.read_links(path)
    assert caught.value.line == line


def test_sessions_become_a_map(run):
    masat.write(walk(3, fixed=0), "a.g2o")
    masat.write(walk(4, fixed=3), "b.g2o")
    Path("links.txt").write_text("0 2 1 0  1 0 0  1 0 0 1 0 1\n")
    code, out, err = run("merge", "a.g2o", "b.g2o", "--between", "links.txt", "-o", "map.g2o")
    assert code == 0
    assert "session 1: b.g2o, 4 nodes, ids 0 to 3 become 1000000 to 1000003" in out
    assert "fixed no longer" in err
    found = masat.read("map.g2o")
    assert_allclose(found.poses, [(k, 0, 0) for k in range(7)], atol=1e-9)
    assert masat.sessions(found).tolist() == [0, 0, 0, 1, 1, 1, 1]


def test_links_may_be_a_graph_in_the_ids_that_are_printed(run):
    masat.write(walk(3), "a.g2o")
    masat.write(walk(4), "b.g2o")
    code, out, _ = run("merge", "a.g2o", "b.g2o", "--ids")
    assert (code, out.splitlines()[1][:21]) == (0, "session 1 (+ 1000000)")
    masat.write(PoseGraph.from_arrays([(2, 10**6)], [STEP]), "links.g2o")
    code, out, _ = run(
        "merge", "a.g2o", "b.g2o", "--between", "links.g2o", "--no-solve", "-o", "both.g2o",
        "--json",
    )  # fmt: skip
    said = json.loads(out)
    assert (code, said["maps"], said["edges"]) == (0, 1, 6)
    assert said["sessions"][1]["shift"] == 10**6
    assert masat.read("both.g2o").edges.tolist()[-1] == [2, 10**6]


def test_sessions_without_links_stay_side_by_side(run):
    masat.write(walk(3), "a.g2o")
    code, _, err = run("merge", "a.g2o", "a.g2o", "-o", "map.g2o")
    assert code == 0
    assert "each stays in a frame of its own" in err
    assert masat.read("map.g2o").components.tolist() == [0, 0, 0, 1, 1, 1]


def test_sessions_with_fixes_need_no_links(run):
    masat.write(fixed_with_gps(3, y=0), "a.g2o")
    masat.write(fixed_with_gps(3, y=4), "b.g2o")
    code, out, err = run("merge", "a.g2o", "b.g2o", "-o", "map.g2o")
    assert (code, err) == (0, "")
    assert "6 nodes, 4 edges, 4 priors" in out
    assert_allclose(masat.read("map.g2o").poses[3:, 1], 4, atol=1e-9)
    masat.write(walk(3), "c.g2o")
    _, _, err = run("merge", "a.g2o", "c.g2o", "-o", "map.g2o")
    assert "each session without priors stays in a frame of its own" in err


def test_false_links_are_rejected_and_written(run):
    graph = clean(manhattan, 300)
    parts, (ends, measured, information) = cut(graph, 2)
    for name, part in zip("ab", parts, strict=True):
        masat.write(part, f"{name}.g2o")
    upper = np.triu_indices(3)
    false = [0, 10, 1, 100, 50, 50, 1, *information[0][upper]]
    table = np.column_stack([ends, measured, information[:, *upper]]).tolist()
    lines = [map(repr, [*map(int, row[:4]), *map(float, row[4:])]) for row in [*table, false]]
    Path("links.txt").write_text("\n".join(map(" ".join, lines)))
    code, _, err = run(
        "merge", "a.g2o", "b.g2o", "--between", "links.txt", "--robust", "-o", "map.g2o",
        "--rejected", "rejected.g2o",
    )  # fmt: skip
    assert (code, err) == (0, "")
    assert masat.read("map.g2o").chi2 == pytest.approx(graph.chi2, rel=1e-6)
    assert masat.read("rejected.g2o").edges.tolist() == [[10, 10**6 + 100]]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("a.g2o", "--rejected", "r.g2o"), "--rejected goes with --robust"),
        (("a.g2o", "--robust", "--no-solve"), "leave out --no-solve"),
        (("a.g2o", "--robust", "--rejected", "r.kitti"), "a trajectory holds no rejected"),
        (("a.g2o", "-o", "a.g2o"), "is the input"),
        (("a.g2o", "no.g2o"), "no.g2o"),
        ((), "Missing argument"),
    ],
)
def test_bad_merges_are_refused(run, arguments, message):
    masat.write(walk(3), "a.g2o")
    code, _, err = run("merge", *arguments)
    assert code == 2
    assert message in err


def test_missing_stamps_are_noticed_before_the_work(run, monkeypatch):
    masat.write(walk(3), "a.g2o")
    monkeypatch.setattr("masat.cli.merge.solved", lambda *_, **__: pytest.fail("it was solved"))
    code, _, err = run("merge", "a.g2o", "a.g2o", "-o", "map.tum")
    assert code == 2
    assert "stamps" in err
