import re
from pathlib import Path

import pytest

import masat
from masat.formats import FORMATS
from masat.worlds import manhattan, perturb

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()


def test_the_examples_of_the_readme_run_in_order(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    masat.write(perturb(manhattan(300, 500, extent=10), (0.1, 0.1, 0.1)), "graph.g2o")
    names = {}
    blocks = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    assert len(blocks) == 3
    for block in blocks:
        exec(block, names)
    assert Path("map.g2o").exists()
    assert Path("map.png").exists()
    assert "RELATIVE_CHANGE" in capsys.readouterr().out


@pytest.mark.parametrize("name", ["g2o", "toro", "isam"])
def test_the_readme_names_every_tag(name):
    for record in FORMATS[name].records:
        assert f"`{record.tag}`" in README


def test_the_readme_names_every_command():
    from masat.cli import _COMMANDS

    for command in _COMMANDS:
        assert f"`masat {command}" in README
