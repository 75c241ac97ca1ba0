"""Trajectories of TUM and KITTI, and stamps in files of g2o."""

import gzip

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from records import WORLD

from masat import FormatError, GraphError, PoseGraph, lie, read, write
from masat.formats.stamps import read_stamps, seconds_texts, stamp_texts
from masat.worlds import manhattan, sphere

NANOSECONDS = 1305031098665900000
# Stamp, position (1, 2, 3), a quarter turn about z.
TUM = "# ground truth\n10.5 1 2 3 0 0 0.7071067811865476 0.7071067811865476\n11 0 0 0 0 0 0 1\n"
KITTI = "0 -1 0 1 1 0 0 2 0 0 1 3\n1 0 0 0 0 1 0 0 0 0 1 0\n"
QUARTER = [1, 2, 3, 0, 0, 0.5**0.5, 0.5**0.5]


def trajectory(poses, stamps=None):
    size = np.shape(poses)[1]
    return PoseGraph.from_arrays(
        np.empty((0, 2), int), np.empty((0, size)), ids=range(len(poses)), poses=poses,
        stamps=stamps,
    )  # fmt: skip


def test_tum_is_stamp_position_quaternion(read):
    graph = read(TUM)
    assert graph.ids.tolist() == [0, 1]
    assert graph.stamps.tolist() == [10.5, 11.0]
    assert graph.stamps.dtype == np.float64
    assert_allclose(graph.poses[0], QUARTER)
    assert len(graph.edges) == 0
    assert graph.notes == ()


def test_kitti_is_the_upper_rows_of_a_matrix(read):
    graph = read(KITTI)
    assert graph.ids.tolist() == [0, 1]
    assert graph.stamps is None
    assert_allclose(graph.poses, [QUARTER, [0, 0, 0, 0, 0, 0, 1]], atol=1e-15)
    assert graph.notes == ()


def test_the_rounded_matrices_of_kitti_are_rotations(read):
    rng = np.random.default_rng(0)
    q = rng.normal(size=(50, 4))
    poses = np.hstack([rng.normal(size=(50, 3)), q / np.linalg.norm(q, axis=1, keepdims=True)])
    from masat import _core

    rows = np.dstack([_core.rotation_matrices(poses), poses[:, :3, None]]).reshape(-1, 12)
    again = read("".join(" ".join(f"{x:.6e}" for x in row) + "\n" for row in rows))
    assert np.abs(lie.local(poses, again.poses)).max() < 1e-5
    assert_allclose(np.linalg.norm(again.poses[:, 3:], axis=1), 1, atol=1e-15)


@pytest.mark.parametrize(
    ("text", "line", "message"),
    [
        (TUM + "12 0 0 0 0 0 1\n", 4, "stamp x y z qx qy qz qw; the line ends after 6 of 7"),
        (TUM + "12 0 0 0 0 0 0 1 9\n", 4, "found '9' after the last number"),
        (TUM + "12 0 a 0 0 0 0 1\n", 4, "found 'a' where a number belongs"),
        (TUM + "1x 0 0 0 0 0 0 1\n", 4, "found '1x' where a number belongs"),
        (TUM + "12 0 nan 0 0 0 0 1\n", 4, "not finite"),
        (TUM + "-inf 0 0 0 0 0 0 1\n", 4, "not finite"),
        (TUM + "1e999 0 0 0 0 0 0 1\n", 4, "'1e999' is too large a number"),
        (TUM + "12 0 0 0 0 0 0 0\n", 4, "the quaternion is zero"),
        (TUM + "12 0 0 0 0 0 0 2\n", 4, "quaternion of length 2"),
        (TUM + "10.50 0 0 0 0 0 0 1\n", 4, "the stamp 10.50 occurs twice"),
        (KITTI + "1 0 0 0 0 1 0 0 0 0 1\n", 3, "the line ends after 11 of 12 numbers"),
        (KITTI + "1 0 0 0 0 1 0 0 0 0 1 0 0\n", 3, "found '0' after the last number"),
        (KITTI + "1 0 0 0 0 1 0 0 0 0 1 inf\n", 3, "not finite"),
        (KITTI + "1 0 0 0 0 1 0 0 0 0 1.1 0\n", 3, "the left 3x3 block of the matrix is no rot"),
        (KITTI + "1 0 0 0 0 1 0 0 0 0 -1 0\n", 3, "the left 3x3 block of the matrix is no rot"),
        (KITTI + "1e200 0 0 0 0 1 0 0 0 0 1 0\n", 3, "the left 3x3 block of the matrix is no rot"),
        (KITTI + "0 0 0 0 0 0 0 0 0 0 0 0\n", 3, "the left 3x3 block of the matrix is no rot"),
    ],
)
def test_a_malformed_line_is_named(read, text, line, message):
    with pytest.raises(FormatError, match=message) as caught:
        read(text)
    assert caught.value.line == line


@pytest.mark.parametrize(
    ("text", "seen"),
    [
        ("1 2 3 4 5 6 7\n", "7 columns"),
        ("timestamp x y z\n", "timestamp"),
        ("1,2,3\n", "1 columns"),
    ],
)
def test_other_tables_are_no_trajectories(read, text, seen):
    with pytest.raises(FormatError, match=f"no line of a pose graph found.* {seen}"):
        read(text)


def test_a_header_is_skipped_with_a_note(read_with_notes):
    graph = read_with_notes("timestamp tx ty tz qx qy qz qw\n1 0 0 0 0 0 0 1\n")
    assert graph.notes == ("1 line with the unknown tag timestamp skipped (first: line 1)",)


def test_stamps_need_no_order_in_a_file_and_are_written_in_order(read, tmp_path):
    graph = read("3 3 0 0 0 0 0 1\n1 1 0 0 0 0 0 1\n2 2 0 0 0 0 0 1\n")
    assert graph.stamps.tolist() == [3, 1, 2]
    write(graph, tmp_path / "o.tum")
    assert (tmp_path / "o.tum").read_text() == (
        "1.0 1 0 0 0 0 0 1\n2.0 2 0 0 0 0 0 1\n3.0 3 0 0 0 0 0 1\n"
    )


def test_kitti_is_written_in_the_order_of_the_ids(tmp_path):
    write(trajectory([(1, 2, np.pi / 2), (0, 0, 0)]), tmp_path / "o.kitti")
    first, second = np.loadtxt(tmp_path / "o.kitti")
    assert_allclose(first, [0, -1, 0, 1, 1, 0, 0, 2, 0, 0, 1, 0], atol=1e-15)
    assert_array_equal(second, [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0])


@pytest.mark.parametrize("world", [manhattan(50, 70, extent=5), sphere(50, 80)], ids=["2D", "3D"])
def test_maps_read_back_as_poses_in_3d(tmp_path, world):
    graph = world.with_stamps(np.arange(50) / 3)
    for name in ("o.tum", "o.tum.gz", "o.kitti", "o.kitti.gz"):
        write(graph, tmp_path / name)
        again = read(tmp_path / name)
        assert again.dimension == 3
        assert np.abs(lie.local(again.poses, lie.to_3d(world.poses))).max() < 1e-15
        if "tum" in name:
            assert_array_equal(again.stamps, graph.stamps)
    assert (tmp_path / "o.tum.gz").read_bytes().startswith(b"\x1f\x8b")
    assert (
        gzip.decompress((tmp_path / "o.kitti.gz").read_bytes())
        == (tmp_path / "o.kitti").read_bytes()
    )


def test_nanoseconds_become_exact_decimals():
    stamps = np.array([NANOSECONDS, NANOSECONDS + 1, 0, 1, -1, -(2**63), 2**63 - 1])
    assert seconds_texts(stamps) == [
        *("1305031098.665900000", "1305031098.665900001", "0.000000000", "0.000000001"),
        *("-0.000000001", "-9223372036.854775808", "9223372036.854775807"),
    ]


@pytest.mark.parametrize("name", ["o.tum", "o.kitti"])
def test_what_a_trajectory_needs_is_named(tmp_path, name):
    bare = PoseGraph.from_arrays([(0, 1)], [(1, 0, 0)])
    with pytest.raises(FormatError, match=f"{name}: the graph has no poses, which .* needs"):
        write(bare, tmp_path / name)
    if name == "o.tum":
        with pytest.raises(FormatError, match=r"o.tum: the graph has no stamps.* \(.kitti\)"):
            write(trajectory([(0, 0, 0)]), tmp_path / name)
        with pytest.raises(GraphError, match=r"nodes 0 and 1 both have the stamp 5\.0"):
            write(trajectory([(0, 0, 0)] * 2, [5.0, 5.0]), tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def test_the_format_overrides_the_suffix(tmp_path):
    write(trajectory([(0, 0, 0)], [1.0]), tmp_path / "o.txt", format="tum")
    assert (tmp_path / "o.txt").read_text() == "1.0 0 0 0 0 0 0 1\n"


# --- stamps in g2o ---


def test_a_stamp_is_a_comment_behind_the_numbers_of_a_vertex(tmp_path):
    graph = trajectory([(1, 2, 0.5), (3, 4, -0.25)], [10.0, 0.1])
    write(graph, tmp_path / "o.g2o")
    assert (tmp_path / "o.g2o").read_text() == (
        "VERTEX_SE2 0 1 2 0.5 # stamp: 10.0\nVERTEX_SE2 1 3 4 -0.25 # stamp: 0.1\n"
    )


finite = st.floats(allow_nan=False, allow_infinity=False)
stamps_of_graphs = st.one_of(
    st.lists(st.integers(-(2**63), 2**63 - 1), min_size=1).map(lambda s: np.array(s, np.int64)),
    st.lists(finite, min_size=1).map(np.array),
)


@given(stamps_of_graphs)
def test_stamps_survive_a_file(tmp_path_factory, stamps):
    path = tmp_path_factory.getbasetemp() / "stamps.g2o"
    write(trajectory([(1, 2, 3)] * len(stamps), stamps), path)
    again = read(path).stamps
    assert again.dtype == stamps.dtype
    assert_array_equal(again, stamps)
    texts = [text.encode() for text in stamp_texts(stamps)]
    assert_array_equal(read_stamps(texts, np.arange(len(stamps))), stamps)


@given(st.lists(finite, min_size=1, unique=True).map(np.array))
def test_seconds_survive_a_trajectory(tmp_path_factory, stamps):
    path = tmp_path_factory.getbasetemp() / "stamps.tum"
    write(trajectory([(1, 2, 3)] * len(stamps), stamps), path)
    assert_array_equal(read(path).stamps, np.sort(stamps))


def stamped(*stamps):
    """WORLD, whose vertices are on lines 1 to 3, with comments."""
    lines = WORLD.splitlines()
    for k, stamp in enumerate(stamps):
        lines[k] += f" # stamp: {stamp}"
    return "\n".join(lines)


@pytest.mark.parametrize("comment", ["# stamp: 2.5", "#stamp:2.5", "#  stamp:  2.5 \t"])
def test_blanks_in_the_comment_do_not_count(read, comment):
    graph = read(f"VERTEX_SE2 0 0 0 0 {comment}\nVERTEX_SE2 1 0 0 0 {comment}\n")
    assert graph.stamps.tolist() == [2.5, 2.5]


@pytest.mark.parametrize("comment", ["# stamps: 1", "# label: 1", "# stamp 1", "# a stamp: 1", "#"])
def test_other_comments_are_no_stamps(read, comment):
    assert read(f"VERTEX_SE2 0 0 0 0 {comment}\n").stamps is None
    assert read(f"# stamp: 1\n{WORLD}# stamp: 2\n").stamps is None


@pytest.mark.parametrize(
    ("stamps", "line", "message"),
    [
        ((1.0, 2.0), 3, "vertex 2 has no stamp, but another one has"),
        ((1.0, ""), 2, "vertex 1 has no stamp, but another one has"),
        ((1.0, 2.0, "noon"), 3, "the stamp 'noon' of vertex 2 is no time"),
        ((1.0, "nan", 3.0), 2, "the stamp 'nan' of vertex 1 is no time"),
        ((1.0, 2.0, "1e999"), 3, "the stamp '1e999' of vertex 2 is no time"),
        ((1.0, "1_0.5", 3.0), 2, "the stamp '1_0.5' of vertex 1 is no time"),
        ((1.0, "1.5 2", 3.0), 2, "the stamp '1.5 2' of vertex 1 is no time"),
        ((1, "9" * 5000, 3), 2, "the stamp '9{39} of vertex 1 is no time"),
        ((1, 2, -(2**63) - 1), 3, "the stamp '-9223372036854775809' of vertex 2 is no time"),
        ((2**63, 2, 3), 1, "an integer of at most 64 bits"),
        ((1, 2.5, 3), 2, "the stamp '2.5' of vertex 1 is in seconds, but those before are in nano"),
        ((1.5, 2, 3), 2, r"is in nanoseconds \(an integer\), but those before are in seconds"),
    ],
)
def test_a_bad_stamp_names_its_line(read, stamps, line, message):
    with pytest.raises(FormatError, match=message) as caught:
        read(stamped(*stamps))
    assert caught.value.line == line


def test_stamps_without_poses_have_no_lines_to_be_written_on(tmp_path):
    graph = PoseGraph.from_arrays([(0, 1)], [(1, 0, 0)], stamps=[1.0, 2.0])
    with pytest.raises(GraphError, match="a graph without poses has no lines of vertices"):
        write(graph, tmp_path / "o.g2o")
