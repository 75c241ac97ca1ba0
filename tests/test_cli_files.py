"""Files that the command line cannot read or write: one line, exit code 2, nothing written."""

import gzip
import os
from pathlib import Path

import pytest
from records import EDGE, WORLD

import masat
from masat import PoseGraph


@pytest.fixture
def convert(run):
    """Run `masat convert` on files made for it; return exit code and standard error."""
    Path("in.g2o").write_text(WORLD)
    Path("folder.g2o").mkdir()
    Path("loop.g2o").symlink_to("loop.g2o")
    Path("bomb.g2o.gz").write_bytes(gzip.compress(bytes(10**6)))
    Path("indefinite.g2o").write_text(EDGE + "EDGE_SE2 1 2 1 2 3 0 1 0 0 0 2\n")

    def call(*arguments):
        code, out, err = run("convert", *arguments)
        assert out == "" or code == 0
        return code, err

    return call


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["in.g2o", "out.csv"], "masat: out.csv: the suffix '.csv' belongs to no format"),
        (["missing.g2o", "out.csv"], "masat: out.csv: the suffix"),
        (["in.g2o", "loop.g2o"], "masat: loop.g2o: Too many levels of symbolic links"),
        (["in.g2o", "folder.g2o"], "masat: folder.g2o: is a folder"),
        (["in.g2o", "missing/out.g2o"], "masat: missing/out.g2o: its folder does not exist"),
        (["folder.g2o", "out.g2o"], "masat: folder.g2o: Is a directory"),
        (["loop.g2o", "out.g2o"], "masat: loop.g2o: Too many levels of symbolic links"),
        (["in.g2o", "out.g2o", "--max-bytes", "100"], "--max-bytes on the command line"),
        (["bomb.g2o.gz", "out.g2o", "--max-bytes", "100"], "--max-bytes on the command line"),
        (["indefinite.g2o", "out.g2o"], "--indefinite nearest on the command line"),
    ],
)
def test_a_bad_file_is_one_line_and_code_2(convert, tmp_path, arguments, message):
    before = sorted(tmp_path.iterdir())
    code, err = convert(*arguments)
    assert (code, err.count("\n")) == (2, 1)
    assert message in err
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full on this system")
def test_a_full_disk_names_the_file(convert):
    assert convert("in.g2o", "/dev/full") == (2, "masat: /dev/full: No space left on device\n")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes on this system")
def test_a_pipe_is_not_read(convert):
    os.mkfifo("pipe")
    code, err = convert("pipe", "out.g2o")
    assert (code, err.count("\n")) == (2, 1)
    assert "masat: pipe: a pipe, expected a regular file" in err


def test_too_little_memory_is_one_line(convert, monkeypatch):
    def fail(*_):
        raise MemoryError

    monkeypatch.setattr("masat.formats.reading.load_text", fail)
    code, err = convert("in.g2o", "out.g2o")
    assert (code, err) == (2, "masat: in.g2o: there is not enough memory to read this file\n")


def test_the_limit_can_be_set(convert):
    assert convert("in.g2o", "out.g2o", "--max-bytes", str(len(WORLD))) == (0, "")


@pytest.mark.parametrize("suffix", ["tum", "kitti"])
def test_a_trajectory_says_in_one_line_what_it_does_not_hold(run, suffix):
    graph = PoseGraph.from_arrays(
        [(0, 1)],
        [(1, 0, 0)],
        poses=[(0, 0, 0), (1, 0, 0)],
        stamps=[1.0, 2.0],
        priors=masat.gps([0, 1], [(0, 0), (1, 0)], 1.0),
        landmarks=masat.landmarks([(0, 9), (1, 9)], [(2, 0), (1, 0)], positions=[(2, 0)]),
    )
    masat.write(graph, "all.g2o")
    code, _, err = run("convert", "all.g2o", f"out.{suffix}")
    assert code == 0
    said = "note: a trajectory holds poses alone: 1 edges, 2 priors and 1 landmarks are not written"
    assert err.splitlines()[0] == said
    masat.write(graph.without_edges([0]), "fixes.g2o")
    _, _, err = run("convert", "fixes.g2o", f"out.{suffix}")
    assert "alone: 2 priors and 1 landmarks are not written" in err


def test_rejected_measurements_are_no_trajectory(run, tmp_path):
    Path("in.g2o").write_text(WORLD)
    code, _, err = run("solve", "in.g2o", "--robust", "--rejected", "r.tum")
    assert (code, err.count("\n")) == (2, 1)
    assert "masat: r.tum: a trajectory holds no rejected measurements; name a file that" in err
    assert [path.name for path in tmp_path.iterdir()] == ["in.g2o"]
