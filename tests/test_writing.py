import errno
import gzip
import os
import signal
import stat
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from numpy.testing import assert_array_equal

from masat import FormatError, PoseGraph, read, write
from masat.formats import FORMATS, format_of

ARRAYS = ("ids", "poses", "edges", "measurements", "information", "fixed")
UNWRITABLE = [name for name, table in FORMATS.items() if table.format_graph is None]

# Every finite double: signed zeros, subnormals and the largest ones too.
doubles = st.floats(allow_nan=False, allow_infinity=False)
factors = st.floats(-1, 1)


def rows(draw, count, dimension):
    """Draw poses of SE(2) or SE(3)."""
    flat = draw(arrays.arrays(float, (count, 3), elements=doubles))
    if dimension == 2:
        return flat
    q = draw(arrays.arrays(float, (count, 4), elements=factors))
    norms = np.linalg.norm(q, axis=1)
    q = np.where(norms[:, None] > 0.1, q / np.maximum(norms, 0.1)[:, None], [0, 0.6, 0, -0.8])
    return np.hstack([flat, q])


@st.composite
def graphs(draw):
    dimension = draw(st.sampled_from([2, 3]))
    dof = 3 * (dimension - 1)
    ids = draw(st.lists(st.integers(-(2**63), 2**63 - 1), min_size=2, max_size=5, unique=True))
    pairs = st.tuples(st.sampled_from(ids), st.sampled_from(ids)).filter(lambda e: e[0] != e[1])
    edges = draw(st.lists(pairs, min_size=1, max_size=5))
    root = draw(arrays.arrays(float, (len(edges), dof, dof), elements=factors))
    scale = 10.0 ** draw(st.integers(-100, 100))
    placed = draw(st.booleans())
    # Without poses nodes live by their edges, and one of a component can be fixed.
    return PoseGraph.from_arrays(
        edges,
        rows(draw, len(edges), dimension),
        (root @ root.transpose(0, 2, 1) + np.eye(dof)) * scale,
        ids=ids if placed else None,
        poses=rows(draw, len(ids), dimension) if placed else None,
        fixed=draw(st.sets(st.sampled_from(ids))) if placed else [edges[0][1]],
    )


def assert_identical(one, other):
    """Compare bit by bit: 0 is not -0 here."""
    for name in ARRAYS:
        a, b = getattr(one, name), getattr(other, name)
        if a is None or b is None:
            assert a is b
        else:
            assert (a.dtype, a.shape, a.tobytes()) == (b.dtype, b.shape, b.tobytes()), name


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("written")


@pytest.fixture
def graph():
    return PoseGraph.from_arrays(
        [[7, -3], [-3, 7]],
        [[1, -0.0, 0.1], [1e-300, 2.5e10, -3]],
        [[[10, 1, 2], [1, 20, 3], [2, 3, 30.5]], np.eye(3)],
        ids=[7, -3],
        poses=[[0, 0, 0], [1, 2, 0.1 + 0.2]],
        fixed=[7],
    )


@pytest.mark.parametrize("name", ["graph.g2o", "graph.g2o.gz"])
@given(graph=graphs())
def test_what_was_written_reads_back_bit_by_bit(folder, name, graph):
    write(graph, folder / name)
    again = read(folder / name)
    assert_identical(again, graph)
    assert again.notes == ()


def test_numbers_of_any_bit_pattern_read_back(folder):
    bits = np.random.default_rng(1).integers(0, 2**64, 30_000, dtype=np.uint64).view(np.float64)
    z = bits[np.isfinite(bits)][:29_700].reshape(-1, 3)
    graph = PoseGraph.from_arrays([[0, 1]] * len(z), z)
    write(graph, folder / "bits.g2o")
    assert_identical(read(folder / "bits.g2o"), graph)


@pytest.mark.parametrize(
    "name", ["2d/intel.g2o", "2d/killian-court.txt", "3d/sphere2500.g2o", "3d/parking-garage.g2o"]
)
def test_real_graphs_read_back_bit_by_bit(folder, data_dir, name):
    graph = read(data_dir / name)
    write(graph, folder / "real.g2o")
    assert_identical(read(folder / "real.g2o"), graph)


def test_the_text_is_that_of_g2o_with_the_shortest_numbers(folder, graph):
    write(graph, folder / "text.g2o")
    assert (folder / "text.g2o").read_text() == (
        "VERTEX_SE2 -3 1 2 0.30000000000000004\n"
        "VERTEX_SE2 7 0 0 0\n"
        "FIX 7\n"
        "EDGE_SE2 7 -3 1 -0 0.1 10 1 2 20 3 30.5\n"
        "EDGE_SE2 -3 7 1e-300 2.5e+10 -3 1 0 0 1 0 1\n"
    )


def test_the_text_in_space_has_quaternions_and_21_numbers_of_information(folder):
    upper = np.triu(np.arange(1.0, 37).reshape(6, 6), 1)
    graph = PoseGraph.from_arrays(
        [[0, 1]], [[1, 2, 3, 0, 0.6, 0, -0.8]], upper + upper.T + 200 * np.eye(6)
    )
    write(graph, folder / "text.g2o")
    assert (folder / "text.g2o").read_text() == (
        "EDGE_SE3:QUAT 0 1 1 2 3 0 0.6 0 -0.8 "
        "200 2 3 4 5 6 200 9 10 11 12 200 16 17 18 200 23 24 200 30 200\n"
    )


def test_a_graph_without_poses_is_written_by_its_edges_alone(folder):
    graph = PoseGraph.from_arrays([[0, 1]], [[1, 0, 0]], ids=[0, 1, 2], fixed=[1, 2])
    write(graph, folder / "edges.g2o")
    again = read(folder / "edges.g2o")
    assert_array_equal(again.edges, graph.edges)
    assert_array_equal(again.fixed, [1])


def test_a_name_that_ends_in_gz_is_compressed(folder, graph):
    write(graph, folder / "plain.g2o")
    write(graph, folder / "packed.g2o.gz")
    packed = (folder / "packed.g2o.gz").read_bytes()
    assert gzip.decompress(packed) == (folder / "plain.g2o").read_bytes()


@pytest.mark.parametrize("ending", ["g2o", "g2o.gz"])
def test_the_bytes_depend_on_the_graph_alone(folder, graph, monkeypatch, ending):
    write(graph, folder / f"one.{ending}")
    monkeypatch.setattr("time.time", lambda: 2e9)
    write(graph, folder / f"two.{ending}")
    assert (folder / f"one.{ending}").read_bytes() == (folder / f"two.{ending}").read_bytes()


def test_the_path_may_be_a_string(tmp_path, graph):
    write(graph, str(tmp_path / "graph.g2o"))
    assert_identical(read(str(tmp_path / "graph.g2o")), graph)


@pytest.mark.parametrize("name", [*UNWRITABLE, "nonsense"])
def test_a_format_that_cannot_be_written_is_refused(tmp_path, graph, name):
    with pytest.raises(FormatError, match=f"cannot write the format '{name}'; known: g2o"):
        write(graph, tmp_path / "graph.txt", format=name)
    assert list(tmp_path.iterdir()) == []


def test_a_format_that_is_no_name_is_refused(tmp_path, graph):
    for name in (7, ["g2o"]):
        with pytest.raises(FormatError, match="cannot write the format"):
            write(graph, tmp_path / "graph.g2o", format=name)


@pytest.mark.parametrize("stem", ["graph", "graph.g2o", "graph.TXT", "v1.2.G2O", ".g2o", ".hidden"])
@pytest.mark.parametrize("gz", ["", ".gz", ".GZ"])
def test_the_suffix_chooses_the_format(tmp_path, graph, stem, gz):
    path = tmp_path / (stem + gz)
    assert format_of(path) == format_of(str(path)) == "g2o"
    write(graph, path)
    assert path.read_bytes().startswith(b"\x1f\x8b") == bool(gz)
    assert_identical(read(path), graph)


@pytest.mark.parametrize("suffix", [".csv", ".graph", ".json", ".csv.gz", ".g2o.zip", ".gz.gz"])
def test_an_unknown_suffix_is_refused_with_the_known_ones(tmp_path, graph, suffix):
    path = tmp_path / f"o{suffix}"
    message = (
        f"o{suffix}: the suffix .* no format that can be written; expected .g2o, .txt, .tum, "
        ".kitti or no"
    )
    for call in (lambda: write(graph, path), lambda: format_of(path)):
        with pytest.raises(FormatError, match=message):
            call()
    assert list(tmp_path.iterdir()) == []
    write(graph, path, format="g2o")
    assert_identical(read(path), graph)


def test_an_existing_file_is_replaced_whole(tmp_path, graph):
    path = tmp_path / "graph.g2o"
    path.write_bytes(b"longer than the graph\n" * 1000)
    write(graph, path)
    assert_identical(read(path), graph)
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("existing", [True, False])
@pytest.mark.parametrize("failure", [OSError("no space left"), KeyboardInterrupt()])
@pytest.mark.parametrize("moment", ["os.fsync", "pathlib.Path.replace"])
def test_a_failure_leaves_the_old_file_and_no_other(
    tmp_path, graph, monkeypatch, existing, failure, moment
):
    def fail(*_):
        raise failure

    path = tmp_path / "graph.g2o"
    if existing:
        path.write_bytes(b"old")
    with monkeypatch.context() as patch:
        patch.setattr(moment, fail)
        with pytest.raises(type(failure)):
            write(graph, path)
    assert [p.name for p in tmp_path.iterdir()] == ["graph.g2o"] * existing
    assert not existing or path.read_bytes() == b"old"


def test_the_new_file_is_complete_on_disk_before_it_takes_its_place(tmp_path, graph, monkeypatch):
    path = tmp_path / "graph.g2o"
    path.write_bytes(b"old")
    synced = []

    def sync(descriptor):
        synced.append((os.fstat(descriptor).st_size, path.read_bytes()))

    monkeypatch.setattr("os.fsync", sync)
    write(graph, path)
    assert synced == [(path.stat().st_size, b"old")]


def test_a_folder_that_does_not_exist_is_not_made(tmp_path, graph):
    path = tmp_path / "missing" / "graph.g2o"
    with pytest.raises(FileNotFoundError) as caught:
        write(graph, path)
    assert caught.value.filename == str(path)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_is_not_replaced(tmp_path, graph):
    (tmp_path / "folder.g2o").mkdir()
    with pytest.raises(IsADirectoryError) as caught:
        write(graph, tmp_path / "folder.g2o")
    assert caught.value.filename == str(tmp_path / "folder.g2o")


def test_a_loop_of_links_is_refused_and_stays(tmp_path, graph):
    (tmp_path / "a.g2o").symlink_to("b.g2o")
    (tmp_path / "b.g2o").symlink_to("a.g2o")
    with pytest.raises(OSError, match="Too many levels of symbolic links") as caught:
        write(graph, tmp_path / "a.g2o")
    assert caught.value.filename == str(tmp_path / "a.g2o")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.g2o", "b.g2o"]
    assert all(p.is_symlink() for p in tmp_path.iterdir())


def test_a_name_that_no_file_can_have_is_refused(tmp_path, graph):
    with pytest.raises(OSError, match="not a valid file name"):
        write(graph, tmp_path / "zero\0byte")


def test_the_longest_name_that_the_system_allows_can_be_written(tmp_path, graph):
    for name in (251 * "n" + ".g2o", 125 * "ä" + ".g2o"):
        write(graph, tmp_path / name)
        assert_identical(read(tmp_path / name), graph)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full on this system")
def test_a_full_device_is_named(graph):
    with pytest.raises(OSError, match=r"No space left on device: '/dev/full'"):
        write(graph, "/dev/full")


def test_a_full_disk_names_the_file_and_leaves_no_other(tmp_path, graph, monkeypatch):
    def full(_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(OSError, match=r"No space left on device: '.*/graph\.g2o'"):
        write(graph, tmp_path / "graph.g2o")
    assert list(tmp_path.iterdir()) == []


INTERRUPTED = """
import os, sys, time
import masat.cli

def hang(descriptor):
    print("writing", flush=True)
    time.sleep(60)

os.fsync = hang
sys.argv = ["masat", "convert", "in.g2o", "out.g2o"]
masat.cli.main()
"""


@pytest.mark.skipif(os.name != "posix", reason="no such signals on this system")
@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGTERM, 143), (signal.SIGHUP, 129), (signal.SIGINT, 130)]
)
def test_a_signal_leaves_no_partial_file(tmp_path, graph, number, code):
    write(graph, tmp_path / "in.g2o")
    command = [sys.executable, "-c", INTERRUPTED]
    with subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "writing\n"
        assert len(list(tmp_path.glob(".out.g2o.*.part"))) == 1
        process.send_signal(number)
        assert process.wait() == code
    assert [p.name for p in tmp_path.iterdir()] == ["in.g2o"]


@pytest.mark.parametrize("mode", [0o600, 0o640, 0o666])
def test_a_replaced_file_keeps_its_mode(tmp_path, graph, mode):
    path = tmp_path / "graph.g2o"
    path.write_bytes(b"old")
    path.chmod(mode)
    write(graph, path)
    assert stat.S_IMODE(path.stat().st_mode) == mode


def test_a_new_file_gets_the_mode_that_any_new_file_gets(tmp_path, graph):
    write(graph, tmp_path / "graph.g2o")
    (tmp_path / "other").write_bytes(b"")
    assert (tmp_path / "graph.g2o").stat().st_mode == (tmp_path / "other").stat().st_mode


@pytest.mark.parametrize("existing", [True, False])
@pytest.mark.parametrize("target", ["real.g2o", "elsewhere/real.g2o"])
def test_a_link_stays_and_its_target_is_replaced(tmp_path, graph, target, existing):
    link, path = tmp_path / "link.g2o", tmp_path / target
    path.parent.mkdir(exist_ok=True)
    if existing:
        path.write_bytes(b"old")
    link.symlink_to(target)
    write(graph, link)
    assert link.readlink().as_posix() == target
    assert not path.is_symlink()
    assert_identical(read(path), graph)
    assert [p.name for p in path.parent.iterdir() if "part" in p.name] == []


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes on this system")
def test_a_pipe_is_written_to_and_stays_a_pipe(tmp_path, graph):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDWR | os.O_NONBLOCK)
    try:
        write(graph, pipe)
        text = os.read(reader, 100_000)
    finally:
        os.close(reader)
    write(graph, tmp_path / "graph.g2o")
    assert text == (tmp_path / "graph.g2o").read_bytes()
    assert stat.S_ISFIFO(pipe.stat().st_mode)
