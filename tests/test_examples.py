"""The programs in examples/ do what they say."""

import importlib.util
from pathlib import Path

import pytest

import masat
from masat import worlds

EXAMPLES = Path(__file__).parents[1] / "examples"


def example(name):
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_simulated_robot_finds_its_way(tmp_path, capsys):
    picture = tmp_path / "map.png"
    reckoned, mapped = example("simulated_robot").main(["--laps", "1.2", "--picture", str(picture)])
    assert mapped < reckoned / 2
    assert mapped < 0.5
    assert picture.stat().st_size > 10_000
    assert "loop closures" in capsys.readouterr().out


def test_a_file_as_a_stream(tmp_path, capsys):
    graph = worlds.perturb(worlds.manhattan(120, 200, seed=1), (0.05, 0.05, 0.03), seed=1)
    masat.write(graph, tmp_path / "graph.g2o")
    chi2, optimum = example("stream_g2o").main([str(tmp_path / "graph.g2o"), "--every", "50"])
    assert optimum == pytest.approx(masat.solve(graph).chi2, rel=1e-6)
    assert optimum * (1 - 1e-9) <= chi2 < 1.01 * optimum
    assert "   100 poses" in capsys.readouterr().out


def test_a_simulated_stream():
    chi2, optimum = example("stream_g2o").main([])
    assert optimum * (1 - 1e-9) <= chi2 < 1.01 * optimum
