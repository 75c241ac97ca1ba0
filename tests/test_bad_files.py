import gzip
import os
import tracemalloc

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from records import COVARIANCE, EDGE, MATRIX_2D, UNIT_2D, UNIT_3D, WORLD

from masat import FormatError, GraphError, MasatError, MasatWarning
from masat.formats import FORMATS
from masat.formats import read as read_file
from masat.formats.text import load_text

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
    "a number just too large": ("VERTEX_SE2 0 1 1.7976931348623159e308 3\n", 1, "is too large"),
    "a number of 400 digits": ("VERTEX_SE2 0 1 " + 400 * "9" + " 3\n", 1, "'9{40}...' is too larg"),
    "a plus sign before inf": ("VERTEX_SE2 0 1 +Infinity 3\n", 1, "not finite"),
    "a hexadecimal exponent": ("VERTEX_SE2 0 1 0x1p3 3\n", 1, "found '0x1p3' where a number"),
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


@pytest.mark.parametrize(
    "line", [line for line in WORLD.splitlines() if line.startswith(("VERTEX", "EDGE"))]
)
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
    with pytest.raises(FormatError, match="unknown format 'g20'; known: " + ", ".join(FORMATS)):
        read(WORLD, format="g20")
    with pytest.raises(FormatError, match="unknown format 7; known: g2o"):
        read(WORLD, format=7)
    with pytest.raises(FormatError, match="unknown format"):
        read(WORLD, format=["g2o"])


def test_a_repair_that_does_not_exist_is_refused_with_those_that_do(read):
    with pytest.raises(FormatError, match='"error", "nearest" or "identity", got \'zero\''):
        read(WORLD, indefinite="zero")


def test_a_file_that_cannot_be_opened_is_the_error_of_the_system(tmp_path):
    with pytest.raises(FileNotFoundError):
        read_file(tmp_path / "missing.g2o")
    with pytest.raises(IsADirectoryError):
        read_file(tmp_path)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes on this system")
def test_pipes_and_devices_are_refused_unread(tmp_path):
    pipe = tmp_path / "pipe.g2o"
    os.mkfifo(pipe)
    with pytest.raises(FormatError, match=r"pipe\.g2o: a pipe, expected a regular file"):
        read_file(pipe)
    with pytest.raises(FormatError, match="/dev/zero: a device or socket, expected a regular"):
        read_file("/dev/zero")
    (tmp_path / "link.g2o").symlink_to(pipe)
    with pytest.raises(FormatError, match="a pipe, expected"):
        read_file(tmp_path / "link.g2o")


@pytest.mark.parametrize("name", ["zero\0byte", "no\udfffname\ud800"])
def test_a_name_that_no_file_can_have_is_refused(name):
    with pytest.raises(FormatError, match="not a valid file name"):
        read_file(name)


LIMIT = r"larger than the limit of \d+ bytes; .*max_bytes=.* in Python, --max-bytes on the command"


@pytest.mark.parametrize("compress", [bytes, gzip.compress])
def test_a_text_larger_than_the_limit_is_refused(read, compress):
    text = WORLD.encode()
    for name in ("graph.g2o", "graph.g2o.gz"):
        with pytest.raises(FormatError, match=LIMIT) as caught:
            read(compress(text), name=name, max_bytes=len(text) - 1)
        assert name in str(caught.value)
    assert_array_equal(read(compress(text), max_bytes=len(text)).ids, [0, 1, 2])


def test_a_gzip_file_is_expanded_no_further_than_to_the_limit(read):
    bomb = gzip.compress(bytes(10**8), 1) + 50 * gzip.compress(bytes(10**7), 1)
    tracemalloc.start()
    try:
        with pytest.raises(FormatError, match=LIMIT):
            read(bomb, max_bytes=10**7)
        assert tracemalloc.get_traced_memory()[1] < 2 * 10**7
    finally:
        tracemalloc.stop()


def test_a_gzip_file_takes_little_more_memory_than_its_text(tmp_path):
    size = 2**25
    (tmp_path / "large.gz").write_bytes(gzip.compress(size * b"#", 1))
    tracemalloc.start()
    try:
        assert len(load_text(tmp_path / "large.gz")) == size
        assert tracemalloc.get_traced_memory()[1] < 1.3 * size
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("max_bytes", [0, -1, 1.5, "1", None])
def test_a_limit_that_is_none_is_refused(read, max_bytes):
    with pytest.raises(FormatError, match="max_bytes must be a positive integer"):
        read(WORLD, max_bytes=max_bytes)


@pytest.mark.parametrize("step", ["load_text", "nearest_positive_definite"])
def test_too_little_memory_is_an_error_that_names_the_file(read, monkeypatch, step):
    def fail(*_):
        raise MemoryError

    monkeypatch.setattr(f"masat.formats.reading.{step}", fail)
    with pytest.raises(FormatError, match=r"large\.g2o: there is not enough memory"):
        read(INDEFINITE, name="large.g2o", indefinite="nearest")


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
    message = (
        r"1 of 3 edges are zero or not positive semidefinite, first that of edge 1 \(1 -> 2\).*-1; "
    )
    with pytest.raises(FormatError, match=message) as caught:
        read("# a bad one\n" + INDEFINITE)
    assert caught.value.line == 3
    assert str(caught.value).endswith(
        'to repair them, choose "nearest" or "identity" (indefinite="nearest" in Python, '
        "--indefinite nearest on the command line)"
    )


def test_the_nearest_positive_definite_information_is_taken_where_asked_for(read_with_notes):
    graph = read_with_notes(INDEFINITE, indefinite="nearest")
    assert_array_equal(graph.information[0], [[4, 1, 0], [1, 4, 0], [0, 0, 4]])
    # Negative eigenvalues become 1e-9 of the largest; those of zero may be meant.
    nearest = np.array([[0.5, 0.5, 0], [0.5, 0.5, 0], [0, 0, 2]])
    assert_allclose(graph.information[1], nearest, rtol=0, atol=3e-9)
    assert_allclose(np.linalg.eigvalsh(graph.information[1]), [2e-9, 1, 2], rtol=1e-6)
    assert_array_equal(graph.information[2], np.diag([4, 0, 1]))
    (note,) = graph.notes
    assert note.startswith("1 information matrices are not positive semidefinite: replaced by")


def test_the_identity_is_taken_for_every_edge_where_asked_for(read_with_notes):
    graph = read_with_notes(INDEFINITE, indefinite="identity")
    assert_array_equal(graph.information, [np.eye(3)] * 3)
    (note,) = graph.notes
    assert note.startswith(
        "1 information matrices are not positive semidefinite: every edge has the identity"
    )


@pytest.mark.parametrize("indefinite", ["nearest", "identity"])
def test_definite_information_is_not_repaired(read, indefinite):
    assert_array_equal(read(WORLD, indefinite=indefinite).information, [MATRIX_2D] * 2)


@pytest.mark.parametrize("numbers", ["0 0 0 0 0 0", "-1 0 0 -2 0 -3"])
def test_information_without_any_positive_eigenvalue_has_no_nearest(read, numbers):
    with pytest.raises(FormatError, match="not positive semidefinite") as caught:
        read(f"{EDGE}EDGE_SE2 0 1 1 2 3 {numbers}\n", indefinite="nearest")
    assert caught.value.line == 2


@pytest.mark.parametrize(
    "numbers",
    ["1e308 1e308 1e308 1e308 1e308 -1e308", "1e308 1e308 0 1e308 0 -1", "1e308 0 1 1 -1 -1e160"],
)
def test_indefinite_information_near_the_largest_double_is_repaired_or_refused(read, numbers):
    with pytest.raises((FormatError, MasatWarning), match=r"not finite|not positive semidefinite"):
        read(f"{EDGE}EDGE_SE2 0 1 1 2 3 {numbers}\n", indefinite="nearest")
