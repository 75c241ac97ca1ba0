"""Damaged files end in a FormatError or in a valid graph."""

import gzip
import random

import numpy as np
import pytest

from masat import FormatError, read
from masat.formats import FORMATS

PLANE = "1 0 0 1 0 1"
SPACE = "1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 0 1"
INLINE = {
    "g2o in the plane": (
        "# a square\n"
        "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 1.57\n"
        "VERTEX_SE2 2 1 1 -3.14\nVERTEX_SE2 3 0 1 -1.57\n"
        "FIX 0 2\n"
        f"EDGE_SE2 0 1 1.0 0.01 1.57 {PLANE}\nEDGE_SE2 1 2 1 -.5e-2 +1.6 50 1e-3 0 50 2 100\n"
        f"EDGE_SE2 2 3 1 0 1.5 {PLANE}\nEDGE_SE2 3 0 1 0 1.55 {PLANE} # label: 7\nEQUIV 0 3\n"
    ),
    "g2o in space": (
        "VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\nVERTEX_SE3:QUAT 1 1 2 3 0.5 -0.5 0.5 0.5\n"
        f"EDGE_SE3:QUAT 0 1 1 2 3 0.6 0 0 -0.8 {SPACE}\n"
        "EDGE_SE3:QUAT 1 0 -1 2e1 3 0 0.7071068 0 0.7071068\n"
    ),
    "g2o with bearings": (
        "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 1.57\nVERTEX_XY 7 2 1\nVERTEX_XY 8 2 -1e0\n"
        f"EDGE_SE2 0 1 1.0 0.01 1.57 {PLANE}\nEDGE_BEARING_SE2_XY 0 7 .5 4\n"
        "EDGE_BEARING_SE2_XY 1 8 -.8 9e1\nEDGE_RANGE_BEARING_SE2_XY 1 7 1.2 -.7 4 .5 9\n"
        "EDGE_SE2_XY 1 8 1 2 1 0 1\n"
    ),
    "g2o with elevations": (
        "VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\nVERTEX_TRACKXYZ 7 1 2 3\n"
        "EDGE_RANGE_BEARING_SE3_XYZ 0 7 3.7 1.1 .9 4 0 .1 9 0 9\n"
    ),
    "TORO in the plane": (
        "VERTEX2 0 0 0 0\nVERTEX2 9 1 0 0.5\nEDGE2 9 0 1 0 0.5 10 1 20 30 2 3\nEQUIV 0 9\n"
        "EDGE2 0 9 1 0 0.5 1 0 1 1 0 0\n"
    ),
    "TORO in space": (
        f"VERTEX3 0 0 0 0 0 0 0\nVERTEX3 1 1 2 3 0.1 0.2 0.3\nEDGE3 0 1 1 2 3 .1 .2 .3 {SPACE}\n"
    ),
    "iSAM in the plane": (
        "ODOMETRY 0 1 1 0 0 50 0 0 50 0 100\nEDGE2 1 2 1 0.1 -4.7 50 1 2 50 3 100\n"
        "EDGE2 2 0 -1 0.1 -4.7 1 0 0 1 0 1\n"
    ),
    "iSAM in space": (f"EDGE3 0 1 1 2 3 .1 .2 .3 {SPACE}\nEDGE3 1 2 1 2 3 -.1 -.2 -.3 {SPACE}\n"),
    "g2o with stamps": (
        "VERTEX_SE2 0 0 0 0 # stamp: 1.5\nVERTEX_SE2 1 1 0 1.57 # stamp: 2e3\n"
        f"EDGE_SE2 0 1 1.0 0.01 1.57 {PLANE}\n"
    ),
    "tum": "# t x y z q\n1.5 1 2 3 0.5 -0.5 0.5 0.5\n2 0 0 0 0 0 0 1\n3.25 1e1 0 0 0 1 0 0\n",
    "kitti": "1 0 0 0.5 0 1 0 0 0 0 1 0\n0 -1 0 1 1 0 0 2 0 0 1 3\n",
    "trajectory": "0 0 0\n1 0 0.1\n2 0.1 0.2\n3 0.3 0.1\n",
    "edge list": (
        "0 1 1.0 0.0 0.1 0.5 0.1 0 0.1 0.5 0 0 0 0.25\n1 2 1.0 0.0 -.1 1e-4 0 0 0 1e-4 0 0 0 1e-2\n"
    ),
}
REAL = [
    "2d/MIT.g2o",
    "2d/killian-court.txt",
    "2d/manhattanOlson3500_isam.txt",
    "2d/w10000.graph.gz",
    "3d/cubicle.g2o",
    "3d/stonewall.g2o",
    "3d/tinyGrid3D.g2o",
    "published_groundtruth/sphere2500_groundtruth.txt",
    "published_groundtruth/manhattanOlson3500_edges_groundTruth.dat",
    "published_groundtruth/ISAM2_GT_city10000.txt",
]
# Words at the edges of what a number, an id or a line may be.
NASTY = [
    *(b"0", b"-0", b"1", b"-1", b"+", b"-", b".", b"+-", b"1.", b".1", b"1e", b"1e+", b"0x1p3"),
    *(b"1e308", b"-1e308", b"1.8e308", b"1e-308", b"5e-324", b"1e-400", b"1e999", b"-1e999"),
    *(
        b"1e99999999999",
        b"nan",
        b"-nan",
        b"NAN(1)",
        b"inf",
        b"-Infinity",
        b"1.#INF",
        b"1,5",
        b"1_0",
    ),
    *(b"9223372036854775807", b"-9223372036854775808", b"9223372036854775808", b"2147483648"),
    *(b"9" * 40, b"123456789012345", b"0.123456789012345678901234567890", b"1" * 5000),
    *(
        b"''",
        b"#",
        b"#0",
        b"\0",
        b"\xff",
        b"FIX",
        b"EQUIV",
        b"ODOMETRY",
        b"VERTEX_SE2",
        b"EDGE_SE2",
    ),
    *(b"VERTEX_SE3:QUAT", b"EDGE_SE3:QUAT", b"VERTEX2", b"EDGE2", b"VERTEX3", b"EDGE3", b"EDGE"),
]
MAGNITUDES = [
    *(b"0", b"1", b"-1", b"1e-320", b"1e-200", b"-1e-8", b"1e100", b"-1e160", b"1e200", b"1e308"),
]


def flip_bits(rng, data):
    out = bytearray(data)
    for _ in range(rng.choice([1, 1, 2, 8, 64])):
        out[rng.randrange(len(out))] ^= 1 << rng.randrange(8)
    return bytes(out)


def replace_bytes(rng, data):
    at = rng.randrange(len(data))
    return data[:at] + rng.randbytes(rng.choice([1, 2, 16, 300])) + data[at + rng.randrange(9) :]


def delete(rng, data):
    at = rng.randrange(len(data))
    return data[:at] + data[at + rng.choice([1, 1, 3, 30, 1000]) :]


def cut(rng, data):
    return data[: rng.randrange(len(data))]


def repeat_chunk(rng, data):
    start, at = rng.randrange(len(data)), rng.randrange(len(data))
    return data[:at] + data[start : start + rng.choice([1, 5, 50, 500])] + data[at:]


def cut_line(rng, data):
    lines = data.split(b"\n")
    k = rng.randrange(len(lines))
    lines[k] = lines[k][: rng.randrange(len(lines[k]) + 1)]
    return b"\n".join(lines)


def swap_lines(rng, data):
    lines = data.split(b"\n")
    a, b = rng.randrange(len(lines)), rng.randrange(len(lines))
    lines[a], lines[b] = lines[b], lines[a]
    return b"\n".join(lines)


def swap_words(rng, data):
    words = data.split(b" ")
    a, b = rng.randrange(len(words)), rng.randrange(len(words))
    words[a], words[b] = words[b], words[a]
    return b" ".join(words)


def nasty_word(rng, data):
    words = data.split(b" ")
    for _ in range(rng.choice([1, 1, 2, 5])):
        words[rng.randrange(len(words))] = rng.choice(NASTY)
    return b" ".join(words)


def nasty_separator(rng, data):
    words = data.split(b" ")
    separator = rng.choice([b"\r", b"\t", b"\f", b"\v", b"\n", b"#", b",", b"\0", b"\xc2\xa0"])
    k = rng.randrange(len(words))
    return b" ".join(words[:k]) + separator + b" ".join(words[k:])


def nasty_numbers(rng, data):
    lines = data.split(b"\n")
    k = rng.randrange(len(lines))
    words = lines[k].split(b" ")
    for index in range(rng.randrange(10), len(words)):
        if rng.random() < 0.5:
            words[index] = rng.choice(MAGNITUDES)
    lines[k] = b" ".join(words)
    return b"\n".join(lines)


BYTES = [flip_bits, replace_bytes, delete, cut, repeat_chunk]
WORDS = [cut_line, swap_lines, swap_words, nasty_word, nasty_separator, nasty_numbers]


def damaged(rng, data):
    for _ in range(rng.choice([1, 1, 2, 4])):
        data = rng.choice([*BYTES, *WORDS, *WORDS])(rng, data) or b"\n"
    kind = rng.randrange(12)
    if kind == 0:
        data = b"\xef\xbb\xbf" + data
    elif kind == 1:
        data = gzip.compress(data, 1)
    elif kind == 2:
        data = rng.choice(BYTES)(rng, gzip.compress(data, 1))
    elif kind == 3:
        data = rng.randbytes(rng.randrange(2000))
    return data


def excerpt(rng, lines):
    """Join some lines from anywhere, so that files of any size take the same time."""
    count = rng.choice([3, 20, 60])
    starts = [rng.randrange(len(lines)) for _ in range(rng.choice([1, 2]))]
    return b"".join(line for start in starts for line in lines[start : start + count])


def assert_valid(graph):
    assert len(graph.components) == len(graph.ids) > 0
    assert (np.diff(graph.ids.astype(object)) > 0).all()
    assert np.isin(graph.edges, graph.ids).all()
    assert (graph.edges[:, 0] != graph.edges[:, 1]).all()
    for poses in (graph.measurements, graph.poses):
        if poses is not None:
            assert np.isfinite(poses).all()
            assert np.allclose(np.linalg.norm(poses[:, 3:], axis=1), 1) or graph.dimension == 2
    assert np.isfinite(graph.information).all()
    scaled = graph.information / np.abs(graph.information).max(axis=(1, 2), keepdims=True)
    assert np.linalg.eigvalsh(scaled).min(initial=0) > -1e-9


def ends_in_a_graph(path, **options):
    try:
        graph = read(path, **options)
    except FormatError:
        return False
    assert_valid(graph)
    return True


def attack(text_of, seed, rounds, path):
    """Read `rounds` damaged texts; return how many ended in a graph."""
    rng = random.Random(seed)
    survived = 0
    for _ in range(rounds):
        text = damaged(rng, text_of(rng))
        path.write_bytes(text)
        name = rng.choice([*[None] * 20, *FORMATS])
        indefinite = rng.choice(["error", "nearest", "identity"])
        try:
            survived += ends_in_a_graph(path, format=name, indefinite=indefinite)
        except BaseException as error:
            error.add_note(f"format={name!r}, indefinite={indefinite!r}, text {text[:3000]!r}")
            raise
    return survived


pytestmark = pytest.mark.filterwarnings("ignore::masat.MasatWarning")


def inline(name):
    return lambda _: INLINE[name].encode()


def whole(path):
    data = path.read_bytes()
    text = gzip.decompress(data) if path.suffix == ".gz" else data
    return lambda _: text


def excerpts(path):
    lines = whole(path)(None).splitlines(keepends=True)
    return lambda rng: excerpt(rng, lines)


@pytest.mark.parametrize("name", INLINE)
def test_damaged_texts_never_break_the_reader(tmp_path, name):
    survived = attack(inline(name), name, 500, tmp_path / "damaged")
    # Some get through: the damage reaches the checks behind the parser too.
    assert 20 < survived < 480


@pytest.mark.parametrize("name", REAL)
def test_damaged_excerpts_of_real_files_never_break_the_reader(tmp_path, data_dir, name):
    attack(excerpts(data_dir / name), name, 200, tmp_path / "damaged")


def test_random_bytes_never_break_the_reader(tmp_path):
    rng = random.Random(1)
    for _ in range(500):
        alphabet = rng.choice([bytes(range(256)), b"0123456789.-+eE# \n\r\t", b"EDGE_SE2 01\n"])
        (tmp_path / "noise").write_bytes(bytes(rng.choices(alphabet, k=rng.randrange(400))))
        ends_in_a_graph(tmp_path / "noise", format=rng.choice([None, *FORMATS]))


@pytest.mark.slow
@pytest.mark.parametrize("name", INLINE)
def test_many_damaged_texts_never_break_the_reader(tmp_path, name):
    attack(inline(name), f"many {name}", 20_000, tmp_path / "damaged")


@pytest.mark.slow
@pytest.mark.parametrize("name", REAL)
def test_many_damaged_excerpts_never_break_the_reader(tmp_path, data_dir, name):
    attack(excerpts(data_dir / name), f"many {name}", 5000, tmp_path / "damaged")


@pytest.mark.slow
@pytest.mark.parametrize("name", REAL)
def test_many_damaged_real_files_never_break_the_reader(tmp_path, data_dir, name):
    attack(whole(data_dir / name), f"whole {name}", 300, tmp_path / "damaged")
