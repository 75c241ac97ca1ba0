import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
from studies import GOOD

from masat.datasets import GRID_WORLDS
from masat.study import Design, Store, load_design, parse_run
from masat.study.design import INITS
from masat.study.design_file import shipped
from masat.worlds import WORLDS


def call(*arguments):
    command = [sys.executable, "-m", "masat", "study", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True)


def test_a_study_from_the_command_line(tmp_path):
    design = tmp_path / "design.toml"
    design.write_text(GOOD)
    store, report = tmp_path / "store", tmp_path / "report"
    told = call("run", design, "--store", store, "--workers", 2)
    assert told.returncode == 0, told.stderr
    assert "4 of 4 runs done" in told.stdout
    assert json.loads(call("status", store, "--json").stdout)["done"] == 4
    assert call("report", store, "-o", report).returncode == 0
    assert (report / "report.html").exists()
    name = "manhattan:100:150/.1,.1,.1/1/masat"
    said = json.loads(call("run", design, "--only", name).stdout)
    with Store(store) as kept:
        (same,) = [t for t in kept.trials() if f"{t.case.name}/{t.init}" == name]
    assert tuple(said["chi2"]) == same.chi2


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["run", "grand", "--store", "s"], "there is no such design"),
        (["run", "quick"], "--store"),
        (["run", "quick", "--only", "nonsense"], "names no run"),
        (["run", "quick", "--only", "manhattan:100:150/.1,.1,.1/0/magic"], "unknown initial guess"),
        (["run", "quick", "--only", "MIT//0/ground_truth"], "no ground truth"),
        (["run", "quick", "--only", "Atlantis//0/masat"], "unknown dataset 'Atlantis'"),
        (["run", "quick", "--only", "sphere:20:30/.1,.1,.1/0/masat"], "a 2D graph has 3 sigmas"),
        (["run", "quick", "--store", "s", "--workers", "100000"], "--workers"),
        (["run", "binary.toml", "--store", "s"], "binary.toml:1: is not UTF-8 text"),
        (["run", "huge.toml", "--store", "s"], "huge.toml:4: instances must be at most"),
        (["status", "broken"], "study.sqlite: not a readable store"),
        (["report", "broken", "-o", "r"], "study.sqlite: not a readable store"),
        (["design", "grand"], "no design 'grand' comes with masat"),
        (["status", "nowhere"], "holds no study"),
        (["report", "nowhere", "-o", "r"], "holds no study"),
    ],
)
def test_bad_usage_is_code_2_and_one_line(arguments, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("binary.toml").write_bytes(bytes(range(256)).replace(b"\n", b""))
    Path("huge.toml").write_text(GOOD.replace("instances = 2", f"instances = {10**12}"))
    Path("broken").mkdir()
    Path("broken/study.sqlite").write_bytes(b"no database " * 1000)
    told = call(*arguments)
    assert told.returncode == 2
    assert said in told.stderr
    assert "Traceback" not in told.stderr
    if "usage" not in told.stderr.lower():
        assert told.stderr.count("\n") == 1


def test_a_shipped_design_is_printed_to_start_from(tmp_path):
    assert call("design").stdout.split() == ["false_closures", "inits", "paper", "quick", "spatial"]
    told = call("design", "quick")
    assert told.returncode == 0
    copy = tmp_path / "quick.toml"
    copy.write_text(told.stdout)
    assert load_design(str(copy)) == load_design("quick")


def test_the_help_of_run_names_every_key_of_a_design():
    text = call("run", "--help").stdout
    for key in Design.__dataclass_fields__:
        assert f"\n  {key} " in text
    assert "docs/studies.md" in text


# The manual, docs/studies.md

MANUAL = (Path(__file__).parents[1] / "docs" / "studies.md").read_text()


def blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", MANUAL, re.DOTALL)


def test_the_example_of_the_manual_runs(tmp_path, monkeypatch, capsys):
    (toml,), (commands,), (python,) = blocks("toml"), blocks("sh"), blocks("python")
    monkeypatch.chdir(tmp_path)
    path = Path("my_study.toml")
    path.write_text(toml)
    assert load_design(str(path)).runs() == 20 * 3 * 3 + 2 * 2
    # The same with fewer instances of smaller worlds, and without data.
    for old, new in (
        ("manhattan:1000:1550", "manhattan:60:90"),
        ("sphere:500:1000", "sphere:40:70"),
        ("instances = 20", "instances = 2"),
        ('graphs = ["MIT", "sphere2500"]\n', ""),
    ):
        assert old in toml
        toml = toml.replace(old, new)
        python = python.replace(old, new)
    path.write_text(toml)
    for line in commands.splitlines():
        name, study, *arguments = line.split()
        assert (name, study) == ("masat", "study")
        told = call(*arguments)
        assert told.returncode == 0, told.stderr
    text = Path("report/report.md").read_text()
    assert text.startswith("# MASAT and chordal, in 2D and 3D\n")
    assert "18 of 18 runs" in text
    assert "failed" not in text.split("## ", 2)[2]
    exec(python, {})
    assert capsys.readouterr().out[0].isdigit()


def test_the_manual_names_every_key_initial_guess_world_and_table(tmp_path):
    for name in (*Design.__dataclass_fields__, *INITS, *GRID_WORLDS, *WORLDS, *shipped()):
        assert f"`{name}`" in MANUAL
    for key in Design.__dataclass_fields__:
        assert f"\n| `{key}` |" in MANUAL


def test_the_runs_that_the_manual_repeats_are_those_of_its_design(tmp_path):
    path = tmp_path / "my_study.toml"
    path.write_text(blocks("toml")[0])
    design = load_design(str(path))
    names = re.findall(r"--only (\S+)$", MANUAL, re.MULTILINE)
    assert len(names) == 3
    for name in names:
        case, init = parse_run(name)
        assert case in design.cases()
        assert init in design.columns_of(case)
