import gzip
import random
import re
from contextlib import nullcontext

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from masat import FormatError, GraphError, MasatError, MasatWarning, PoseGraph, lie
from masat.formats import FORMATS
from masat.formats import read as read_file

H = np.sqrt(0.5)
UNIT_2D = "1 0 0 1 0 1"
UNIT_3D = "1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 0 1"
# Every entry different: the order of the numbers shows.
MATRIX_2D = np.array([[10.0, 1, 2], [1, 20, 3], [2, 3, 30]])
MATRIX_3D = np.array(
    [
        [101.0, 1, 2, 3, 4, 5],
        [1, 102, 6, 7, 8, 9],
        [2, 6, 103, 10, 11, 12],
        [3, 7, 10, 104, 13, 14],
        [4, 8, 11, 13, 105, 15],
        [5, 9, 12, 14, 15, 106],
    ]
)
COVARIANCE = "0 1 1 2 3 1 0 0 0 1 0 0 0 1\n"
UPPER_3D = "101 1 2 3 4 5 102 6 7 8 9 103 10 11 12 104 13 14 105 15 106"
EDGE = f"EDGE_SE2 0 1 1 2 0.5 {UNIT_2D}\n"


@pytest.fixture(scope="module")
def read(tmp_path_factory):
    """Write text or bytes to a file and read it as a graph; a warning is an error."""
    folder = tmp_path_factory.mktemp("formats")

    def read(text, name="graph.txt", **options):
        path = folder / name
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return read_file(path, **options)

    return read


@pytest.fixture
def read_with_notes(read):
    """Read, and check that each note is also a warning that names the file."""

    def read_with_notes(text, **options):
        with pytest.warns(MasatWarning) as caught:
            graph = read(text, **options)
        warned = [str(w.message) for w in caught]
        assert len(warned) == len(graph.notes)
        for note, warning in zip(graph.notes, warned, strict=True):
            assert re.fullmatch(r".*graph\.txt: " + re.escape(note), warning)
        return graph

    return read_with_notes


def test_g2o_in_the_plane(read):
    graph = read(
        "VERTEX_SE2 7 1 2 0.5\nVERTEX_SE2 3 4 5 -4\nFIX 7\nEDGE_SE2 7 3 6 7 3.5 10 1 2 20 3 30\n"
    )
    assert_array_equal(graph.ids, [3, 7])
    assert_array_equal(graph.poses, [[4, 5, -4], [1, 2, 0.5]])
    assert_array_equal(graph.fixed, [7])
    assert_array_equal(graph.edges, [[7, 3]])
    assert_array_equal(graph.measurements, [[6, 7, 3.5]])
    assert_array_equal(graph.information, [MATRIX_2D])
    assert graph.notes == ()


def test_g2o_in_space(read):
    graph = read(
        "VERTEX_SE3:QUAT 0 1 2 3 0.6 0 0 -0.8\n"
        "VERTEX_SE3:QUAT 1 4 5 6 0 0 0 1\n"
        f"EDGE_SE3:QUAT 0 1 7 8 9 0 0.8 0 0.6 {UPPER_3D}\n"
    )
    assert_array_equal(graph.poses, [[1, 2, 3, 0.6, 0, 0, -0.8], [4, 5, 6, 0, 0, 0, 1]])
    assert_array_equal(graph.measurements, [[7, 8, 9, 0, 0.8, 0, 0.6]])
    assert_array_equal(graph.information, [MATRIX_3D])


def test_fix_takes_several_ids_a_line(read):
    vertices = "".join(f"VERTEX_SE2 {k} 0 0 0\n" for k in range(5))
    assert_array_equal(read(vertices + "FIX 4 0\nFIX 2\nFIX 0\n" + EDGE).fixed, [0, 2, 4])


def test_g2o_edges_in_space_without_information_get_the_identity_and_a_note(read_with_notes):
    graph = read_with_notes(
        "EDGE_SE3:QUAT 0 1 1 2 3 0 0 0 1\n"
        f"EDGE_SE3:QUAT 1 2 1 2 3 0 0 0 1 {UPPER_3D}\n"
        "EDGE_SE3:QUAT 2 3 1 2 3 0 0 0 1 # none\n"
    )
    assert_array_equal(graph.information, [np.eye(6), MATRIX_3D, np.eye(6)])
    assert graph.notes == ("2 edges have no information: identity taken",)


def test_rounded_quaternions_are_normalised(read):
    graph = read("EDGE_SE3:QUAT 0 1 0 0 0 0 0 0.7071068 0.7071068 " + UNIT_3D)
    assert_allclose(graph.measurements[0, 3:], [0, 0, H, H], rtol=0, atol=2.3e-16)


@pytest.mark.parametrize(("vertex", "edge"), [("VERTEX2", "EDGE2"), ("VERTEX", "EDGE")])
def test_toro_in_the_plane_lists_xx_xy_yy_tt_xt_yt(read, vertex, edge):
    graph = read(f"{vertex} 0 1 2 0.5\n{vertex} 1 3 4 1\n{edge} 1 0 5 6 0.25 10 1 20 30 2 3\n")
    assert_array_equal(graph.poses, [[1, 2, 0.5], [3, 4, 1]])
    assert_array_equal(graph.edges, [[1, 0]])
    assert_array_equal(graph.measurements, [[5, 6, 0.25]])
    assert_array_equal(graph.information, [MATRIX_2D])


def test_toro_in_space_has_information_in_angles_which_are_twice_the_quaternion_vector(read):
    graph = read(
        f"VERTEX3 0 1 2 3 0 0 0\nVERTEX3 1 4 5 6 0 0 0\nEDGE3 0 1 7 8 9 0 0 0 {UPPER_3D}\n"
    )
    assert_array_equal(graph.poses, [[1, 2, 3, 0, 0, 0, 1], [4, 5, 6, 0, 0, 0, 1]])
    assert_array_equal(graph.measurements, [[7, 8, 9, 0, 0, 0, 1]])
    assert_array_equal(graph.information[0, :3, :3], MATRIX_3D[:3, :3])
    assert_array_equal(graph.information[0, :3, 3:], 2 * MATRIX_3D[:3, 3:])
    assert_array_equal(graph.information[0, 3:, :3], 2 * MATRIX_3D[3:, :3])
    assert_array_equal(graph.information[0, 3:, 3:], 4 * MATRIX_3D[3:, 3:])


@pytest.mark.parametrize(
    ("roll_pitch_yaw", "quaternion"),
    [
        ((np.pi / 2, 0, 0), (H, 0, 0, H)),
        ((0, np.pi / 2, 0), (0, H, 0, H)),
        ((0, 0, np.pi / 2), (0, 0, H, H)),
        # R = Rz(yaw) Ry(pitch) Rx(roll): k i = j, k j = -i, j i = -k.
        ((np.pi / 2, 0, np.pi / 2), (0.5, 0.5, 0.5, 0.5)),
        ((0, np.pi / 2, np.pi / 2), (-0.5, 0.5, 0.5, 0.5)),
        ((np.pi / 2, np.pi / 2, 0), (0.5, 0.5, -0.5, 0.5)),
    ],
)
def test_roll_pitch_and_yaw_turn_about_the_fixed_axes_x_y_and_z(read, roll_pitch_yaw, quaternion):
    angles = " ".join(map(repr, map(float, roll_pitch_yaw)))
    graph = read(
        f"VERTEX3 0 0 0 0 0 0 0\nVERTEX3 1 0 0 0 {angles}\nEDGE3 0 1 0 0 0 {angles} {UNIT_3D}"
    )
    assert_allclose(graph.poses[1, 3:], quaternion, atol=1e-15)
    assert_allclose(graph.measurements[0, 3:], quaternion, atol=1e-15)


@pytest.mark.parametrize("tag", ["ODOMETRY", "EDGE2"])
def test_isam_in_the_plane_lists_the_upper_square_root_of_the_information(read, tag):
    graph = read(f"{tag} 0 1 1 2 0.5 2 1 3 4 5 6\n", format="isam")
    assert_array_equal(graph.measurements, [[1, 2, 0.5]])
    assert_array_equal(graph.information, [[[4, 2, 6], [2, 17, 23], [6, 23, 70]]])


def test_isam_in_space_lists_the_square_root_for_roll_pitch_and_yaw(read):
    root = "1 0 0 1 0 0 2 0 0 0 0 3 0 0 0 4 0 0 5 0 6"
    graph = read(f"EDGE3 0 1 1 2 3 0 0 {np.pi / 2!r} {root}\n", format="isam")
    expected = np.diag([1.0, 4, 9, 4 * 17, 4 * 25, 4 * 36])
    expected[0, 3] = expected[3, 0] = 2
    assert_array_equal(graph.information, [expected])
    assert_allclose(graph.measurements, [[1, 2, 3, 0, 0, H, H]], atol=1e-15)


def test_odometry_settles_that_edge2_is_that_of_isam(read):
    graph = read("ODOMETRY 0 1 1 0 0 2 0 0 3 0 4\nEDGE2 1 0 1 0 0 2 0 0 3 0 4\n")
    assert_array_equal(graph.information, [np.diag([4, 9, 16])] * 2)


def test_edge2_alone_is_read_as_isam_with_a_note_that_it_may_be_toro(read, read_with_notes):
    text = "EDGE2 0 1 1 2 0.5 2 1 3 4 5 6\n"
    graph = read_with_notes(text)
    assert_array_equal(graph.information, read(text, format="isam").information)
    assert graph.notes == ('the tags fit isam and toro: read as isam; choose with format="toro"',)


def test_the_format_asked_for_is_taken_without_a_note(read):
    text = "EDGE2 0 1 1 2 0.5 10 1 20 30 2 3\n"
    assert_array_equal(read(text, format="toro").information, [MATRIX_2D])


def test_lines_of_three_numbers_are_a_trajectory_numbered_from_zero(read):
    graph = read("0 0 0\n-1 +2 .5 # back\n\n3 4 -1e-1\n")
    assert_array_equal(graph.ids, [0, 1, 2])
    assert_array_equal(graph.poses, [[0, 0, 0], [-1, 2, 0.5], [3, 4, -0.1]])
    assert len(graph.edges) == 0


def test_lines_of_fourteen_numbers_are_edges_with_their_covariance(read):
    graph = read("0 1 1 2 0.5 0.5 0.25 0 0.25 0.5 0 0 0 2\n4 1 3 4 -0.5 1 0 0 0 1 0 0 0 1\n")
    assert_array_equal(graph.ids, [0, 1, 4])
    assert_array_equal(graph.edges, [[0, 1], [4, 1]])
    assert_array_equal(graph.measurements, [[1, 2, 0.5], [3, 4, -0.5]])
    # 0.5 * 0.5 - 0.25 * 0.25 = 3 / 16
    inverse = np.array([[8, -4, 0], [-4, 8, 0], [0, 0, 1.5]]) / 3
    assert_allclose(graph.information, [inverse, np.eye(3)], rtol=1e-15)


def test_vertices_alone_make_a_graph_without_edges(read):
    graph = read("VERTEX_SE3:QUAT 5 1 2 3 0 0 0 1\n")
    assert (graph.dimension, len(graph.ids), len(graph.edges)) == (3, 1, 0)


def test_edges_alone_make_a_graph_without_poses(read):
    graph = read(f"EDGE_SE2 9 -2 1 0 0 {UNIT_2D}\n")
    assert_array_equal(graph.ids, [-2, 9])
    assert graph.poses is None


def test_ids_may_be_any_integers_of_64_bits(read):
    low, high = -(2**63), 2**63 - 1
    graph = read(f"EDGE_SE2 {high} {low} 1 0 0 {UNIT_2D}\n")
    assert graph.ids.tolist() == [low, high]


WORLD = (
    "VERTEX_SE2 0 0 0 0\n"
    "VERTEX_SE2 1 1 2 0.5\n"
    "VERTEX_SE2 2 3 4 -0.25\n"
    "FIX 0\n"
    "EDGE_SE2 0 1 1 2 0.5 10 1 2 20 3 30\n"
    "EDGE_SE2 1 2 3 4 -0.75 10 1 2 20 3 30\n"
)
LINES = WORLD.splitlines()
SAME_WORLD = {
    "CRLF": WORLD.replace("\n", "\r\n"),
    "tabs": WORLD.replace(" ", "\t"),
    "runs of blanks": WORLD.replace(" ", "  \t "),
    "indented lines": "\n".join(" \t" + line for line in LINES),
    "trailing blanks": WORLD.replace("\n", " \t \n"),
    "no final newline": WORLD.rstrip(),
    "blank lines": "\n \n" + WORLD.replace("\n", "\n\n\t\n"),
    "comment lines": "# made by hand\n" + WORLD.replace("\n", "\n  # EDGE_SE2 0 0\n#\n"),
    "comments after the numbers": WORLD.replace("\n", " # 1 2 3\n"),
    "byte order mark": "\ufeff" + WORLD,
    "plus signs": re.sub(r" (\d)", r" +\1", WORLD),
    "exponents": WORLD.replace(" 10 ", " 1e1 ")
    .replace(" 0.5", " +5.0E-1")
    .replace(" 4 ", " .4e+1 "),
    "trailing and leading points": WORLD.replace(" 0.5", " .5").replace(" 30", " 30."),
    "interleaved": "\n".join([LINES[4], LINES[2], LINES[0], LINES[3], LINES[5], LINES[1]]),
    "gzip": gzip.compress(WORLD.encode()),
    "gzip in two members": gzip.compress(WORLD[:50].encode()) + gzip.compress(WORLD[50:].encode()),
}


@pytest.mark.parametrize("name", ["graph.g2o", "graph.g2o.gz", "graph"])
@pytest.mark.parametrize("variant", SAME_WORLD)
def test_layout_compression_and_file_name_do_not_change_the_graph(read, variant, name):
    graph, plain = read(SAME_WORLD[variant], name=name), read(WORLD)
    for array in ("ids", "poses", "edges", "measurements", "information", "fixed"):
        assert_array_equal(getattr(graph, array), getattr(plain, array))


def test_numbers_below_the_smallest_double_are_zero(read):
    graph = read(f"EDGE_SE2 0 1 1e-400 -1e-999 +2e-9999 {UNIT_2D}\n")
    assert_array_equal(graph.measurements, [[0, 0, 0]])


def test_numbers_are_read_to_the_nearest_double(read):
    graph = read(f"EDGE_SE2 0 1 0.1 5e-324 1.7976931348623157e308 {UNIT_2D}\n")
    assert graph.measurements[0].tolist() == [0.1, 5e-324, 1.7976931348623157e308]


def decimal(rng):
    """Return a number as people write them: few digits or many, with a point or an exponent."""
    whole, rest = ("".join(rng.choices("0123456789", k=rng.randrange(20))) for _ in range(2))
    point = rng.choice([f"{whole}.{rest}", whole, f".{rest}"])
    exponent = rng.choice(["", "", f"e{rng.randint(-330, 280)}", f"E+{rng.randrange(9)}"])
    return rng.choice(["", "-", "+"]) + (point if point.strip(".") else "0") + exponent


def test_every_decimal_is_read_as_python_reads_it(read):
    rng = random.Random(1)
    words = [[decimal(rng) for _ in range(3)] for _ in range(10_000)]
    poses = read("\n".join(map(" ".join, words))).poses
    expected = np.array([[float(word) for word in row] for row in words])
    assert_array_equal(poses.view(np.uint64), expected.view(np.uint64))


def test_unknown_tags_are_passed_over_with_one_note_each(read, read_with_notes):
    graph = read_with_notes(
        "PARAMS_SE2OFFSET 0 0 0 0\n" + WORLD + "EQUIV 0 1\n# EQUIV 7 8\nequiv\nEQUIV a b\n"
    )
    assert graph.notes == (
        "1 lines with the unknown tag PARAMS_SE2OFFSET passed over (first: line 1)",
        "2 lines with the unknown tag EQUIV passed over (first: line 8)",
        "1 lines with the unknown tag equiv passed over (first: line 10)",
    )
    assert_array_equal(graph.measurements, read(WORLD).measurements)


@pytest.mark.parametrize(
    "tag",
    [b"LONG" * 1000, b"\x1b[2J\x07", b"\xff\xfe\xfd", b"A\0B"],
    ids=["long", "control", "no ASCII", "zero byte"],
)
def test_notes_of_strange_tags_are_short_and_printable(read_with_notes, tag):
    (note,) = read_with_notes(200 * EDGE.encode() + tag + b" 1 2\n").notes
    assert len(note) < 200
    assert note.isprintable()


MALFORMED = {
    "a cut edge": ("EDGE_SE2 0 1 1 2\n", 1, "from to x y theta .* ends after 2 of 3 numbers"),
    "cut information": ("EDGE_SE2 0 1 1 2 3 1 0\n", 1, "6 information numbers.* 2 of 6"),
    "no information": ("EDGE_SE2 0 1 1 2 3\n", 1, "6 information numbers.* 0 of 6"),
    "cut information in space": (
        "EDGE_SE3:QUAT 0 1 1 2 3 0 0 0 1 1 0 0\n",
        1,
        r"21 information numbers \(or none\).* 3 of 21",
    ),
    "a tag alone": ("VERTEX_SE2\n", 1, "id x y theta; the line ends before the id"),
    "an edge with one id": ("EDGE_SE2 1\n", 1, "from to .* the line ends before the id"),
    "a fix without id": (EDGE + "FIX # 0\n", 2, "FIX takes: id; the line ends before the id"),
    "a vertex cut in space": ("VERTEX_SE3:QUAT 0 1 2 3 0 0 0\n", 1, "x y z qx qy qz qw.* 6 of 7"),
    "a cut pose": ("0 0 0\n1 2\n", 2, "x y theta; the line ends after 2 of 3"),
    "a cut covariance": (COVARIANCE + "0 1 1 2 3 1\n", 2, "9 covariance .* 1 of 9"),
    "a number too many": (EDGE[:-1] + " 7\n", 1, "found '7' after the last number"),
    "a word at the end": (EDGE[:-1] + " end\n", 1, "found 'end' after the last number"),
    "a word for a number": ("VERTEX_SE2 0 1 two 3\n", 1, "found 'two' where a number belongs"),
    "a decimal comma": ("VERTEX_SE2 0 1 2,5 3\n", 1, "found '2,5' where a number belongs"),
    "a hexadecimal": ("VERTEX_SE2 0 1 0x10 3\n", 1, "found '0x10' where a number belongs"),
    "a digit group": ("VERTEX_SE2 0 1 1_000 3\n", 1, "found '1_000' where a number belongs"),
    "two signs": ("VERTEX_SE2 0 1 +-2 3\n", 1, r"found '\+-2' where a number belongs"),
    "two signs of an id": ("VERTEX_SE2 +-5 1 2 3\n", 1, r"found '\+-5' where an integer id"),
    "a sign alone": ("VERTEX_SE2 0 1 + 3\n", 1, r"found '\+' where a number belongs"),
    "a point alone": ("VERTEX_SE2 0 1 . 3\n", 1, r"found '\.' where a number belongs"),
    "an exponent alone": ("VERTEX_SE2 0 1 1e 3\n", 1, "found '1e' where a number belongs"),
    "a nan": ("VERTEX_SE2 0 1 NaN 3\n", 1, "not finite"),
    "a nan with a payload": ("VERTEX_SE2 0 1 nan(7) 3\n", 1, "not finite"),
    "an infinity": ("VERTEX_SE2 0 1 -inf 3\n", 1, "not finite"),
    # What some C libraries print for infinity: no 1 with a comment.
    "an infinity as 1.#INF": ("VERTEX_SE2 0 1 2 1.#INF\n", 1, "1.#INF"),
    "an infinite information": ("EDGE_SE2 0 1 1 2 3 1 0 0 1 0 inf\n", 1, "not finite"),
    "a number too large": ("VERTEX_SE2 0 1 -1e999 3\n", 1, "'-1e999' is too large"),
    "an id too large": ("VERTEX_SE2 9223372036854775808 1 2 3\n", 1, "does not fit in 64 bits"),
    "an id too small": ("FIX -9223372036854775809\n" + EDGE, 1, "does not fit in 64 bits"),
    "a decimal id": ("EDGE_SE2 0 1.0 1 2 3 1 0 0 1 0 1\n", 1, "found '1.0' where an integer id"),
    "an exponent as id": ("VERTEX_SE2 1e3 1 2 3\n", 1, "found '1e3' where an integer id"),
    "a word as id": ("VERTEX_SE2 x 1 2 3\n", 1, "found 'x' where an integer id"),
    "a self-loop": (EDGE + EDGE.replace("0 1", "7 7", 1), 2, "vertex 7 to itself; expected two"),
    "a zero quaternion": ("VERTEX_SE3:QUAT 0 1 2 3 0 0 0 0\n", 1, "zero.* expected .* unit length"),
    "a quaternion far off": ("VERTEX_SE3:QUAT 0 1 2 3 0 0 0 2\n", 1, "length 2, expected 1"),
    "a quaternion far off on an edge": (
        EDGE.replace("SE2", "SE3:QUAT").replace(UNIT_2D, "0 0 0 2 " + UNIT_3D),
        1,
        "edge 0 .* length 2, expected 1",
    ),
    "plane and space": (EDGE + "VERTEX_SE3:QUAT 0 1 2 3 0 0 0 1\n", 2, "is 3D, .* before are 2D"),
    "a vertex twice": (WORLD + "VERTEX_SE2 1 0 0 0\n", 7, "node id 1 occurs twice"),
    "an edge to no vertex": (WORLD + "EDGE_SE2 2 9 1 2 3 1 0 0 1 0 1\n", 7, "names node 9"),
    "a fixed vertex that is none": (
        WORLD + "FIX 2 9\n",
        7,
        "FIX names vertex 9, .* not in the file",
    ),
    "a fixed id that no edge names": ("\n" + EDGE + "FIX 9\n", 3, "FIX names vertex 9"),
    "numbers among tags": (EDGE + "# a comment\n\n1 2 3\n", 4, "expected a tag, found '1'"),
    "a singular covariance": ("0 1 1 2 3" + " 0" * 9, 1, "covariance .* singular"),
    "a root that overflows": ("ODOMETRY 0 1 1 2 3 1e200 0 0 1 0 1", 1, "information .* overflows"),
}


@pytest.mark.parametrize("newline", ["\n", "\r\n"])
@pytest.mark.parametrize("case", MALFORMED)
def test_a_malformed_line_is_named_with_what_was_expected(read, case, newline):
    text, line, message = MALFORMED[case]
    with pytest.raises(FormatError, match=message) as caught:
        read(text.replace("\n", newline), name="malformed.g2o")
    assert caught.value.line == line
    assert caught.value.path.name == "malformed.g2o"
    assert str(caught.value).startswith(f"{caught.value.path}:{line}: ")


@pytest.mark.parametrize("line", [line for line in LINES if line.startswith(("VERTEX", "EDGE"))])
def test_no_cut_through_a_line_goes_unnoticed(read, line):
    words = line.split()
    for count in range(1, len(words)):
        with pytest.raises(FormatError, match="the line ends") as caught:
            read(f"{EDGE}{' '.join(words[:count])}\n{EDGE}")
        assert caught.value.line == 2


COMPRESSED = gzip.compress(WORLD.encode())
UNREADABLE = {
    "an empty file": (b"", "the file is empty"),
    "blank lines only": (b"\n \r\n\t\n", "the file is empty"),
    "comments only": (b"# a graph\n  # to come\n", "the file is empty"),
    "an empty gzip": (gzip.compress(b""), "the file is empty"),
    "a binary file": (b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR", "a binary file"),
    "UTF-16": (WORLD.encode("utf-16"), "a binary file"),
    "prose": (b"once upon\na time\n", "begin with: once, a; known formats: g2o, isam, toro"),
    "numbers of no known count": (b"1 2 3 4\n", "begin with: 4 columns; known formats"),
    "a fixed vertex only": (b"FIX 0\n", "neither a vertex nor an edge"),
    "gzip magic only": (b"\x1f\x8b", "damaged gzip"),
    "a cut gzip": (COMPRESSED[:-20], "damaged gzip"),
    "a gzip without its checksum": (COMPRESSED[:-8], "damaged gzip"),
    "a gzip with a wrong checksum": (COMPRESSED[:-8] + bytes(8), "damaged gzip"),
    "a gzip with a wrong method": (COMPRESSED[:2] + b"\7" + COMPRESSED[3:], "damaged gzip"),
    "a gzip with wrong bits": (COMPRESSED[:10] + b"\xff" * 20, "damaged gzip"),
    "garbage after a gzip": (COMPRESSED + b"garbage", "damaged gzip"),
}


@pytest.mark.parametrize("case", UNREADABLE)
def test_a_file_that_holds_no_graph_is_named_with_the_reason(read, case):
    data, message = UNREADABLE[case]
    with pytest.raises(FormatError, match=message) as caught:
        read(data, name="unreadable.g2o")
    assert caught.value.line is None
    assert str(caught.value).startswith(f"{caught.value.path}: ")


def test_several_fixed_vertices_without_poses_are_refused(read):
    with pytest.raises(FormatError, match=r"several fixed nodes .* need poses"):
        read(EDGE + "FIX 0 1\n")


def test_no_record_of_the_format_asked_for_is_an_error(read):
    with pytest.raises(FormatError, match="neither a vertex nor an edge"):
        read(WORLD, format="toro")


def test_a_format_that_does_not_exist_is_refused_with_those_that_do(read):
    with pytest.raises(ValueError, match="unknown format 'g20'; known: " + ", ".join(FORMATS)):
        read(WORLD, format="g20")


def test_a_repair_that_does_not_exist_is_refused_with_those_that_do(read):
    with pytest.raises(ValueError, match='"error", "nearest" or "identity", got \'zero\''):
        read(WORLD, indefinite="zero")


def test_a_file_that_cannot_be_opened_is_the_error_of_the_system(tmp_path):
    with pytest.raises(FileNotFoundError):
        read_file(tmp_path / "missing.g2o")
    with pytest.raises(IsADirectoryError):
        read_file(tmp_path)


def test_format_errors_are_value_errors_and_of_the_family():
    assert issubclass(FormatError, ValueError)
    assert issubclass(FormatError, MasatError)
    assert not issubclass(FormatError, GraphError)


# Eigenvalues 1, -1 and 2; then 4, 0 and 1.
INDEFINITE = (
    "EDGE_SE2 0 1 1 2 3 4 1 0 4 0 4\n"
    "EDGE_SE2 1 2 1 2 3 0 1 0 0 0 2\n"
    "EDGE_SE2 2 3 1 2 3 4 0 0 0 0 1\n"
)


def test_indefinite_information_is_counted_and_the_first_line_named(read):
    message = r"2 of 3 edges are not positive definite, first that of edge 1 \(1 -> 2\).*-1; "
    with pytest.raises(FormatError, match=message) as caught:
        read("# two bad ones\n" + INDEFINITE)
    assert caught.value.line == 3
    assert 'indefinite="nearest" or indefinite="identity"' in str(caught.value)


def test_the_nearest_positive_definite_information_is_taken_where_asked_for(read_with_notes):
    graph = read_with_notes(INDEFINITE, indefinite="nearest")
    assert_array_equal(graph.information[0], [[4, 1, 0], [1, 4, 0], [0, 0, 4]])
    # Negative and vanishing eigenvalues become 1e-9 of the largest.
    nearest = np.array([[0.5, 0.5, 0], [0.5, 0.5, 0], [0, 0, 2]])
    assert_allclose(graph.information[1], nearest, rtol=0, atol=3e-9)
    assert_allclose(np.linalg.eigvalsh(graph.information[1]), [2e-9, 1, 2], rtol=1e-6)
    assert_allclose(graph.information[2], np.diag([4, 4e-9, 1]), rtol=0, atol=1e-15)
    (note,) = graph.notes
    assert note.startswith("2 information matrices are not positive definite: replaced by")


def test_the_identity_is_taken_for_every_edge_where_asked_for(read_with_notes):
    graph = read_with_notes(INDEFINITE, indefinite="identity")
    assert_array_equal(graph.information, [np.eye(3)] * 3)
    (note,) = graph.notes
    assert note.startswith("2 information matrices are not positive definite: so every edge")


@pytest.mark.parametrize("indefinite", ["nearest", "identity"])
def test_definite_information_is_not_repaired(read, indefinite):
    assert_array_equal(read(WORLD, indefinite=indefinite).information, [MATRIX_2D] * 2)


@pytest.mark.parametrize("numbers", ["0 0 0 0 0 0", "-1 0 0 -2 0 -3"])
def test_information_without_any_positive_eigenvalue_has_no_nearest(read, numbers):
    with pytest.raises(FormatError, match="not positive definite") as caught:
        read(f"{EDGE}EDGE_SE2 0 1 1 2 3 {numbers}\n", indefinite="nearest")
    assert caught.value.line == 2


@pytest.mark.parametrize(
    "numbers",
    ["1e308 1e308 1e308 1e308 1e308 -1e308", "1e308 1e308 0 1e308 0 -1", "1e308 0 1 1 -1 -1e160"],
)
def test_indefinite_information_near_the_largest_double_is_repaired_or_refused(read, numbers):
    with pytest.raises((FormatError, MasatWarning), match=r"not finite|not positive definite"):
        read(f"{EDGE}EDGE_SE2 0 1 1 2 3 {numbers}\n", indefinite="nearest")


RIVAL = "the tags fit isam and toro"
BARE = "have no information"
# Dimension, vertices, edges, whether there are poses, and what the notes say.
FILES = {
    "2d/10kHog-man.txt.gz": (2, 10000, 64311, True, ()),
    "2d/CSAIL.g2o": (2, 1045, 1172, False, ()),
    "2d/FR079_P_g2o.g2o": (2, 989, 1217, True, ()),
    "2d/INTEL_P_g2o.g2o": (2, 1228, 1505, True, ()),
    "2d/MIT.g2o": (2, 808, 827, True, ()),
    "2d/ais2klinik.g2o": (2, 15115, 16727, True, ()),
    "2d/city10000.g2o": (2, 10000, 20687, True, ()),
    "2d/city10000_isam.txt": (2, 10000, 20687, False, (RIVAL,)),
    "2d/city10k.txt": (2, 10000, 20687, False, ()),
    "2d/input_INTEL_g2o.g2o": (2, 1228, 1483, True, ()),
    "2d/input_M3500_g2o.g2o": (2, 3500, 5453, True, ()),
    "2d/intel.g2o": (2, 1728, 2512, True, ()),
    "2d/intel_vertigo.g2o": (2, 943, 1837, True, ()),
    "2d/killian-court.txt": (2, 1941, 3995, True, ()),
    "2d/kitti_00.g2o": (2, 4541, 4677, False, ()),
    "2d/kitti_06.g2o": (2, 1101, 1150, False, ()),
    "2d/kitti_07.g2o": (2, 1101, 1106, False, ()),
    "2d/kitti_08.g2o": (2, 4071, 4070, False, ()),
    "2d/kitti_09.g2o": (2, 1591, 1592, False, ()),
    "2d/manhattan.g2o": (2, 3500, 5453, False, ()),
    "2d/manhattanOlson3500.g2o": (2, 3500, 5598, True, ()),
    "2d/manhattanOlson3500_isam.txt": (2, 3500, 5598, False, ()),
    "2d/manhattanOlson3500_olson.g2o": (2, 3500, 5598, True, ()),
    "2d/ring.g2o": (2, 434, 459, True, ()),
    "2d/ring_groundtruth.g2o": (2, 434, 459, True, ()),
    "2d/w10000.graph.gz": (2, 10000, 64311, True, ("5875 lines with the unknown tag EQUIV",)),
    "3d/burghers.g2o": (3, 1124, 4118, True, (f"4118 edges {BARE}",)),
    "3d/car.g2o": (3, 6523, 22207, True, (f"22207 edges {BARE}",)),
    "3d/parking-garage.g2o": (3, 1661, 6275, True, ()),
    "3d/sphere2500.g2o": (3, 2500, 4949, True, ()),
    "3d/sphere3D.g2o.gz": (3, 5000, 19599, True, ()),
    "3d/sphere_bignoise_vertex3.g2o": (3, 2200, 8647, True, ()),
    "3d/stonewall.g2o": (3, 271, 888, True, (f"888 edges {BARE}",)),
    "3d/tinyGrid3D.g2o": (3, 9, 11, True, ()),
    "3d/torus3D.g2o.gz": (3, 5000, 9048, True, ()),
    "City10k_groundtruth.g2o": (2, 10000, 20687, True, ()),
    "M3500_5598_groundtruth.g2o": (2, 3500, 5598, True, ()),
    "M3500_groundtruth.g2o": (2, 3500, 5453, True, ()),
    "Manhattan10000_groundtruth.g2o.gz": (2, 10000, 64311, True, ()),
    "sphere2500_groundtruth.g2o": (3, 2500, 4949, True, ()),
    "published_groundtruth/ISAM2_GT_city10000.txt": (2, 10000, 0, True, ()),
    "published_groundtruth/city10000_groundtruth.txt": (2, 10000, 20687, False, (RIVAL,)),
    "published_groundtruth/manhattanOlson3500_edges_groundTruth.dat": (2, 3500, 5598, False, ()),
    "published_groundtruth/manhattanOlson3500_groundtruth.txt": (2, 3500, 5598, False, (RIVAL,)),
    "published_groundtruth/manhattanOlson3500_nodes_groundTruth.dat": (2, 3500, 0, True, ()),
    "published_groundtruth/sphere2500_groundtruth.txt": (3, 2500, 4949, False, (RIVAL,)),
}


@pytest.fixture(scope="module")
def real(data_dir):
    """Read a file of the data folder whatever it is noted for, each once."""
    graphs: dict[str, PoseGraph] = {}

    def real(name):
        if name not in graphs:
            noted = FILES[name][-1]
            with pytest.warns(MasatWarning) if noted else nullcontext():
                graphs[name] = read_file(data_dir / name)
        return graphs[name]

    return real


@pytest.mark.parametrize("name", FILES)
def test_real_files_have_the_vertices_and_edges_that_they_are_known_for(real, name):
    dimension, vertices, edges, placed, notes = FILES[name]
    graph = real(name)
    assert (graph.dimension, len(graph.ids), len(graph.edges)) == (dimension, vertices, edges)
    assert_array_equal(graph.ids, np.arange(vertices))
    assert (graph.poses is not None) == placed
    assert len(graph.notes) == len(notes)
    for note, beginning in zip(graph.notes, notes, strict=True):
        assert note.startswith(beginning)
    assert len(np.unique(graph.components)) == (1 if edges else vertices)


def test_the_indefinite_matrices_of_cubicle_are_counted_and_can_be_repaired(data_dir):
    path = data_dir / "3d/cubicle.g2o"
    with pytest.raises(FormatError, match="of 5021 of 16869 edges are not positive definite"):
        read_file(path)
    for indefinite in ("nearest", "identity"):
        with pytest.warns(MasatWarning, match="5021 information matrices are not positive"):
            graph = read_file(path, indefinite=indefinite)
        assert (len(graph.ids), len(graph.edges)) == (5750, 16869)
        assert np.linalg.eigvalsh(graph.information).min() > 0


def residuals(graph):
    """Return the errors of the edges at the poses of the graph."""
    start, end = graph.edge_indices.T
    return lie.local(graph.measurements, lie.between(graph.poses[start], graph.poses[end]))


# Sums of e' Omega e at the vertices of the file, found once by the g2o library.
COSTS = {
    "2d/10kHog-man.txt.gz": 6880893.6,
    "2d/FR079_P_g2o.g2o": 8502.7737,
    "2d/INTEL_P_g2o.g2o": 4943388.6,
    "2d/MIT.g2o": 4.4141817e09,
    "2d/ais2klinik.g2o": 1297393.9,
    "2d/city10000.g2o": 6.5416269e08,
    "2d/input_INTEL_g2o.g2o": 5149721,
    "2d/input_M3500_g2o.g2o": 2566667.7,
    "2d/intel.g2o": 551.73573,
    "2d/intel_vertigo.g2o": 1331.4989,
    "2d/killian-court.txt": 2.0467303e-07,
    "2d/manhattanOlson3500.g2o": 69142.942,
    "2d/manhattanOlson3500_olson.g2o": 2566434.3,
    "2d/ring.g2o": 2041063.9,
    "2d/ring_groundtruth.g2o": 3.2854855e-08,
    "2d/w10000.graph.gz": 49440240,
    "3d/burghers.g2o": 591.05865,
    "3d/car.g2o": 368.73865,
    "3d/parking-garage.g2o": 16720.018,
    "3d/sphere2500.g2o": 2547810.9,
    "3d/sphere3D.g2o.gz": 1.3474545e11,
    "3d/sphere_bignoise_vertex3.g2o": 1.7663122e08,
    "3d/stonewall.g2o": 187.13396,
    "3d/tinyGrid3D.g2o": 213.06437,
    "3d/torus3D.g2o.gz": 2946826.5,
}


@pytest.mark.parametrize("name", COSTS)
def test_real_files_cost_at_their_vertices_what_g2o_says(real, name):
    graph = real(name)
    error = residuals(graph)
    cost = np.einsum("ki,kij,kj->", error, graph.information, error)
    assert cost == pytest.approx(COSTS[name], rel=1e-7)


@pytest.mark.parametrize("name", [name for name in FILES if name.count("groundtruth.g2o")])
def test_ground_truth_agrees_with_its_own_edges(real, name):
    # The printed numbers of the ring have six decimals, those of the others all their digits.
    assert np.abs(residuals(real(name))).max() < (2e-6 if "ring" in name else 2e-13)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("M3500_groundtruth.g2o", "2d/input_M3500_g2o.g2o"),
        ("M3500_5598_groundtruth.g2o", "2d/manhattanOlson3500.g2o"),
        ("M3500_5598_groundtruth.g2o", "2d/manhattanOlson3500_isam.txt"),
        ("City10k_groundtruth.g2o", "2d/city10k.txt"),
        ("City10k_groundtruth.g2o", "2d/city10000_isam.txt"),
        ("Manhattan10000_groundtruth.g2o.gz", "2d/10kHog-man.txt.gz"),
        ("sphere2500_groundtruth.g2o", "3d/sphere2500.g2o"),
    ],
)
def test_files_of_one_world_have_the_same_edges_in_the_same_order(real, one, other):
    assert_array_equal(real(one).edges, real(other).edges)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("City10k_groundtruth.g2o", "2d/city10000.g2o"),
        ("Manhattan10000_groundtruth.g2o.gz", "2d/w10000.graph.gz"),
    ],
)
def test_files_of_one_world_have_the_same_pairs_in_any_order(real, one, other):
    pairs = [np.unique(np.sort(real(name).edges), axis=0) for name in (one, other)]
    assert_array_equal(*pairs)


def test_g2o_and_isam_files_of_city10k_are_one_graph(real):
    g2o, isam = real("2d/city10k.txt"), real("2d/city10000_isam.txt")
    for name in ("ids", "edges", "measurements", "information"):
        assert_array_equal(getattr(g2o, name), getattr(isam, name))


def test_g2o_and_isam_files_of_manhattan_measure_the_same(real):
    g2o, isam = real("2d/manhattanOlson3500.g2o"), real("2d/manhattanOlson3500_isam.txt")
    assert_array_equal(g2o.measurements, isam.measurements)
    # This g2o file holds the square root where the information belongs.
    assert_allclose(g2o.information**2, isam.information, rtol=1e-15)


@pytest.mark.parametrize(
    ("published", "exact", "within"),
    [
        ("manhattanOlson3500_groundtruth.txt", "M3500_5598_groundtruth.g2o", 4e-6),
        ("manhattanOlson3500_edges_groundTruth.dat", "M3500_5598_groundtruth.g2o", 4e-6),
        ("city10000_groundtruth.txt", "City10k_groundtruth.g2o", 4e-6),
        # Roll, pitch and yaw here, quaternions there.
        ("sphere2500_groundtruth.txt", "sphere2500_groundtruth.g2o", 5e-6),
    ],
)
def test_published_edges_are_the_exact_ones_to_their_printed_digits(real, published, exact, within):
    printed, exact = real(f"published_groundtruth/{published}"), real(exact)
    # The order differs, and repeated pairs measure the same.
    order = [np.lexsort(graph.edges.T) for graph in (printed, exact)]
    assert_array_equal(printed.edges[order[0]], exact.edges[order[1]])
    steps = lie.local(printed.measurements[order[0]], exact.measurements[order[1]])
    assert np.abs(steps).max() < within


@pytest.mark.parametrize(
    ("published", "exact", "within"),
    [
        ("manhattanOlson3500_nodes_groundTruth.dat", "M3500_5598_groundtruth.g2o", 4e-6),
        ("ISAM2_GT_city10000.txt", "City10k_groundtruth.g2o", 1.1e-4),
    ],
)
def test_published_trajectories_are_the_exact_ones_to_their_printed_digits(
    real, published, exact, within
):
    printed, exact = real(f"published_groundtruth/{published}"), real(exact)
    assert np.abs(lie.local(printed.poses, exact.poses)).max() < within
