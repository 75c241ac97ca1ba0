import json
import subprocess
import sys
from pathlib import Path

import pytest
from studies import GOOD

from masat.study import Design, Store, load_design


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
        (["run", "quick", "--only", "sphere:20:30/.1,.1,.1/0/masat"], "noise takes 3 sigmas"),
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
    assert call("design").stdout.split() == ["inits", "paper", "quick"]
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
