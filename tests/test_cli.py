import json
import re
import subprocess
import sys
from time import sleep

import numpy as np
import pytest

import masat
from masat import PoseGraph
from masat.cli import progress
from masat.initializers import INITIALIZERS
from masat.viewing.payload import unpack
from masat.worlds import manhattan, perturb, sphere


@pytest.fixture
def world(tmp_path):
    path = tmp_path / "world.g2o"
    masat.write(perturb(manhattan(300, 500, extent=10), (0.05, 0.05, 0.02)), path)
    return path


def test_solve_writes_the_optimum_and_says_so(run, world, tmp_path):
    out, picture = tmp_path / "map.g2o.gz", tmp_path / "map.png"
    code, text, err = run("solve", world, "-o", out, "--plot", picture)
    assert (code, err) == (0, "")
    best = masat.optimize(masat.initialize(masat.read(world), "auto"))
    assert np.array_equal(masat.read(out).poses, best.poses)
    assert f"chi2 {best.chi2:.6g}" in text
    assert "not optimized  node 0" in text
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_solve_speaks_json(run, world, tmp_path):
    code, text, _ = run("solve", world, "-o", tmp_path / "m.g2o", "--json", "--optimizer", "gn")
    said = json.loads(text)
    assert code == 0
    assert said["optimizer"] == "gauss_newton"
    assert said["converged"] is True
    assert said["nodes"] == 300
    assert len(said["history"]) == said["iterations"]
    assert said["history"][-1]["chi2"] == pytest.approx(said["chi2"])


def test_quiet_says_nothing(run, world, tmp_path):
    assert run("solve", world, "-o", tmp_path / "m.g2o", "--quiet") == (0, "", "")


def test_a_saved_result_can_be_loaded(run, world, tmp_path):
    run("solve", world, "--save", tmp_path / "r.npz", "--init", "odometry", "--root", 0)
    assert masat.Result.load(tmp_path / "r.npz").converged


def test_without_convergence_the_best_is_written_and_the_code_is_1(run, world, tmp_path):
    out = tmp_path / "map.g2o"
    code, text, _ = run("solve", world, "-o", out, "--init", "masat", "--max-iterations", 1)
    assert code == 1
    assert "iteration limit reached" in text
    assert masat.read(out).poses is not None
    code, _, err = run(
        "solve", world, "-o", out, "--init", "masat", "--max-iterations", 1, "--quiet"
    )
    assert code == 1
    assert err.startswith("masat: ")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("EDGE_SE2 0 1 1 0\n", "bad.g2o:1: "),
        ("", "empty"),
        ("EDGE_SE2 0 1 1 0 0 1 0 0 -1 0 1\n", "not positive semidefinite"),
    ],
)
def test_bad_files_are_one_line_and_code_2(run, tmp_path, text, said):
    path = tmp_path / "bad.g2o"
    path.write_text(text)
    for command in (["solve", path], ["info", path], ["compare", path], ["convert", path, "o"]):
        code, out, err = run(*command)
        assert (code, out) == (2, "")
        assert err.count("\n") == 1
        assert said in err


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["solve", "WORLD", "-o", "WORLD"], "is the input"),
        (["solve", "WORLD", "-o", "no/such/folder/m.g2o"], "folder does not exist"),
        (["solve", "WORLD", "--plot", "m.xyz"], "a picture ends in"),
        (["solve", "WORLD", "--root", "777"], "no node 777"),
        (["solve", "missing.g2o"], "No such file"),
        (["solve", "WORLD", "--init", "magic"], "magic"),
        (["convert", "WORLD", "WORLD"], "is the input"),
        (["fly"], "No such command"),
    ],
)
def test_bad_usage_is_code_2(run, world, arguments, said):
    before = world.read_bytes()
    code, out, err = run(*(world if a == "WORLD" else a for a in arguments))
    assert (code, out) == (2, "")
    assert said in err
    assert "Traceback" not in err
    assert world.read_bytes() == before


def test_notes_go_to_standard_error(run, tmp_path):
    path = tmp_path / "odd.g2o"
    path.write_text("EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\nEDGE_SE2 5 6 1 0 0 1 0 0 1 0 1\nLANDMARK 3\n")
    code, _, err = run("solve", path, "-o", tmp_path / "m.g2o")
    assert code == 0
    assert "note: 1 line with the unknown tag LANDMARK" in err
    assert err.count("2 components") == 1


def test_indefinite_information_is_a_choice(run, tmp_path):
    path = tmp_path / "indefinite.g2o"
    path.write_text("EDGE_SE2 0 1 1 0 0 1 0 0 -1 0 1\n")
    for choice in ("nearest", "identity"):
        code, _, err = run("solve", path, "--indefinite", choice)
        assert code == 0
        assert "not positive semidefinite" in err


def test_info_tells_the_figures_and_the_oddities(run, world, tmp_path):
    code, text, _ = run("info", world, "--plot", tmp_path / "p.png")
    assert code == 0
    assert "300, ids 0 to 299" in text
    assert "299 odometry, 201 loop closures" in text
    assert (tmp_path / "p.png").exists()
    said = json.loads(run("info", world, "--json")[1])
    assert said["edges"] == 500


def test_compare_lists_each_start(run, world, tmp_path):
    code, text, _ = run("compare", world, "--optimizer", "gn", "--plot", tmp_path / "p.png")
    assert code == 0
    lines = text.splitlines()
    for start in INITIALIZERS:
        assert any(start in line and "best" in line for line in lines)
    said = json.loads(run("compare", world, "--json")[1])
    assert [s["init"] for s in said["inits"]] == list(INITIALIZERS)
    assert said["failed"] == {}


def test_compare_writes_a_view_of_all_maps(run, world, tmp_path):
    code, _, _ = run("compare", world, "--view", tmp_path / "maps.html")
    assert code == 0
    page = (tmp_path / "maps.html").read_text()
    header, _ = unpack(re.search(r'text/plain">(.*?)</', page)[1])
    assert len(header["states"]) == len(INITIALIZERS)
    assert min(header["chi2"]) == pytest.approx(header["chi2"][-1])


def test_compare_tells_which_initial_guesses_fail_and_why(run, tmp_path):
    path = tmp_path / "bare.g2o"
    graph = sphere(50)
    masat.write(PoseGraph.from_arrays(graph.edges, graph.measurements), path)
    code, text, _ = run("compare", path)
    assert code == 0
    assert "lago fails: lago is for planar graphs only" in text
    assert "given fails: the graph has no poses" in text
    said = json.loads(run("compare", path, "--json")[1])
    assert list(said["failed"]) == ["lago", "given"]
    assert {s["init"] for s in said["inits"]} == set(INITIALIZERS) - {"lago", "given"}


def test_convert_loses_nothing(run, tmp_path):
    toro = tmp_path / "w.graph"
    toro.write_text("VERTEX2 0 0 0 0\nVERTEX2 1 1 0 0\nEDGE2 0 1 1 .5 .1 1 2 9 4 .3 .2\n")
    out = tmp_path / "w.g2o"
    code, text, _ = run("convert", toro, out)
    assert code == 0
    assert "2 nodes, 1 edges" in text
    assert np.allclose(masat.read(out).information, [[1, 2, 0.3], [2, 9, 0.2], [0.3, 0.2, 4]])


def test_demo_needs_no_input(run, tmp_path):
    picture = tmp_path / "demo.png"
    code, text, _ = run("demo", "--nodes", 400, "--plot", picture)
    assert code == 0
    assert "masat" in text
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_help_teaches(run):
    code, text, _ = run("--help")
    assert code == 0
    for word in ("solve", "info", "compare", "convert", "demo", "Exit codes"):
        assert word in text
    assert "Example:  masat solve" in run("solve", "--help")[1]


def test_the_command_is_installed_and_starts_without_matplotlib_and_rich():
    loaded = "import sys, masat.cli.solve; print({'matplotlib', 'rich'} & set(sys.modules))"
    told = subprocess.run([sys.executable, "-c", loaded], capture_output=True, text=True)
    assert told.stdout.strip() == "set()"
    command = [sys.executable, "-m", "masat", "--version"]
    assert subprocess.run(command, capture_output=True, text=True).stdout.startswith("masat")


def test_certify_tells_what_it_proved(run, tmp_path):
    from test_relaxation import ring, twisted

    local, better = tmp_path / "local.g2o", tmp_path / "better.g2o"
    masat.write(ring(12).with_poses(twisted(ring(12))), local)
    code, text, _ = run("certify", local, "-o", better)
    assert code == 1
    assert "not optimal: another minimum" in text
    code, text, _ = run("certify", better)
    assert code == 0
    assert "status        optimal" in text
    said = json.loads(run("certify", local, "--json")[1])
    assert said["certified"] is False
    assert said["optimum"] < said["chi2"]


def test_certify_refuses_to_write_over_its_input(run, tmp_path):
    from test_relaxation import ring, twisted

    path = tmp_path / "graph.g2o"
    masat.write(ring(12).with_poses(twisted(ring(12))), path)
    code, _, error = run("certify", path, "-o", path)
    assert code == 2
    assert "never changed" in error


def test_solve_tells_whether_the_optimum_is_certified(run, tmp_path):
    path = tmp_path / "graph.g2o"
    masat.write(perturb(manhattan(200, seed=0), [0.1, 0.1, 0.1], seed=0), path)
    assert "optimal: no poses have a chi2 that is lower" in run("solve", path)[1]
    assert json.loads(run("solve", path, "--json")[1])["certificate"]["certified"] is True


def test_a_long_wait_shows_what_it_is_for(monkeypatch, capsys):
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    monkeypatch.setattr(progress, "_PATIENCE", 0.01)
    with progress.Stages("city.g2o  auto", quiet=False):
        sleep(0.3)
    assert "city.g2o  auto" in capsys.readouterr().err
    with progress.Stages("city.g2o  auto", quiet=True):
        sleep(0.1)
    monkeypatch.setattr(progress, "_PATIENCE", 60)
    with progress.Stages("city.g2o  auto", quiet=False):
        pass
    assert capsys.readouterr().err == ""
