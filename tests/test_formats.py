import gzip
import locale
import random
import re

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from records import EDGE, MATRIX_2D, UNIT_2D, UNIT_3D, WORLD

from masat import FormatError, write

H = np.sqrt(0.5)
# Every entry different: the order of the numbers shows.
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
UPPER_3D = "101 1 2 3 4 5 102 6 7 8 9 103 10 11 12 104 13 14 105 15 106"


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
    assert graph.notes == ("2 edges have no information: assumed the identity",)


def test_rounded_quaternions_are_normalized(read):
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


def test_with_odometry_edge2_is_that_of_isam(read):
    graph = read("ODOMETRY 0 1 1 0 0 2 0 0 3 0 4\nEDGE2 1 0 1 0 0 2 0 0 3 0 4\n")
    assert_array_equal(graph.information, [np.diag([4, 9, 16])] * 2)


def test_edge2_alone_is_read_as_isam_with_a_note_that_it_may_be_toro(read, read_with_notes):
    text = "EDGE2 0 1 1 2 0.5 2 1 3 4 5 6\n"
    graph = read_with_notes(text)
    assert_array_equal(graph.information, read(text, format="isam").information)
    assert graph.notes == (
        "the tags fit isam and toro: read as isam; if it is toro, name the format "
        '(format="toro" in Python, --format toro on the command line)',
    )


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


COMMA_LOCALES = ["de_DE.UTF-8", "fr_FR.UTF-8", "nl_NL.UTF-8", "pl_PL.UTF-8", "de_DE", "German"]


@pytest.fixture
def comma_locale():
    """Write decimals with a comma in C, as strtod and printf do in many countries."""
    before = locale.setlocale(locale.LC_NUMERIC)
    for name in COMMA_LOCALES:
        try:
            locale.setlocale(locale.LC_NUMERIC, name)
        except locale.Error:
            continue
        if locale.localeconv()["decimal_point"] == ",":
            break
    else:
        pytest.skip("no locale with a decimal comma is installed")
    yield
    locale.setlocale(locale.LC_NUMERIC, before)


def test_numbers_do_not_depend_on_the_locale(read, comma_locale, tmp_path):
    # strtod of this locale stops at the point.
    words = ["1.5e-400", "0.30000000000000004", "1.5e-310", "+1.25", "-2.5e10", "1.5"]
    graph = read(f"{' '.join(words[:3])}\n{' '.join(words[3:])}\n")
    assert graph.poses.ravel().tolist() == [float(word) for word in words]
    with pytest.raises(FormatError, match=r"'1\.5e400' is too large a number"):
        read("0 0 1.5e400\n")
    with pytest.raises(FormatError, match="found '1,5' where a number belongs"):
        read("0 0 1,5\n", format="trajectory")
    write(graph, tmp_path / "graph.g2o")
    assert (tmp_path / "graph.g2o").read_text() == (
        "VERTEX_SE2 0 0 0.30000000000000004 1.5e-310\nVERTEX_SE2 1 1.25 -2.5e+10 1.5\n"
    )


@pytest.mark.parametrize(
    ("word", "value"),
    [
        ("2.4703282292062328e-324", 5e-324),  # just above half of the smallest double
        ("2.4703282292062327e-324", 0),  # just below it
        ("2.2250738585072011e-308", 2.225073858507201e-308),  # between subnormal and normal
        ("1.7976931348623158e308", 1.7976931348623157e308),  # rounds down to the largest double
        ("9007199254740993", 9007199254740992),  # halfway: to even
        ("0." + 400 * "0" + "1", 0),
        ("1" + 400 * "0" + "e-400", 1),
        ("1." + 5000 * "0" + "1", 1),
        ("+1", 1),
    ],
)
def test_numbers_at_the_limits_of_a_double(read, word, value):
    assert read(f"{word} 0 0\n").poses[0, 0] == value == float(word)


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


def test_unknown_tags_are_skipped_with_one_note_each(read, read_with_notes):
    graph = read_with_notes(
        "PARAMS_OTHER 0 0 0 0\n" + WORLD + "EQUIV 0 1\n# EQUIV 7 8\nequiv\nEQUIV a b\n"
    )
    assert graph.notes == (
        "1 line with the unknown tag PARAMS_OTHER skipped (first: line 1)",
        "2 lines with the unknown tag EQUIV skipped (first: line 8)",
        "1 line with the unknown tag equiv skipped (first: line 10)",
    )
    assert_array_equal(graph.measurements, read(WORLD).measurements)


def test_the_first_ten_unknown_tags_have_notes_of_their_own(read_with_notes):
    graph = read_with_notes(EDGE + "".join(f"TAG{k} 1\n" for k in range(12)) + "TAG11 2\n")
    assert len(graph.notes) == 11
    assert graph.notes[9] == "1 line with the unknown tag TAG9 skipped (first: line 11)"
    assert graph.notes[10] == "3 lines with 2 more unknown tags skipped"


@pytest.mark.parametrize(
    "tag",
    [b"LONG" * 1000, b"\x1b[2J\x07", b"\xff\xfe\xfd", b"A\0B"],
    ids=["long", "control", "no ASCII", "zero byte"],
)
def test_notes_of_strange_tags_are_short_and_printable(read_with_notes, tag):
    (note,) = read_with_notes(200 * EDGE.encode() + tag + b" 1 2\n").notes
    assert len(note) < 200
    assert note.isprintable()
