import os
import re
import sys
from pathlib import Path

import pytest
from hypothesis import settings

from masat import MasatWarning
from masat.cli import main
from masat.formats import read as read_file

# Other work on the machine must not fail a test that is right.
settings.register_profile("masat", deadline=None)
settings.load_profile("masat")

SHARED = Path(__file__).parents[2] / "shared"


def pytest_collection_modifyitems(config, items):
    if config.option.markexpr:
        return
    for item in items:
        if "slow" in item.keywords:
            item.add_marker(pytest.mark.skip(reason="slow; run with -m slow"))


def _folder(variable, name):
    path = Path(os.environ.get(variable, SHARED / name))
    if not path.is_dir():
        pytest.skip(f"no folder {path}: set {variable} to where the files lie")
    return path


@pytest.fixture(scope="session")
def data_dir():
    """Folder of the standard pose graphs."""
    return _folder("MASAT_DATA", "data")


@pytest.fixture(scope="session")
def reference_dir():
    """Folder of the outputs of the published MASAT program."""
    return _folder("MASAT_REFERENCE", "reference")


@pytest.fixture(scope="module")
def read(tmp_path_factory):
    """Write text or bytes to a file and read it as a graph; a warning is an error."""
    folder = tmp_path_factory.mktemp("formats")

    def read(text, name="graph.txt", **options):
        path = folder / name
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return read_file(path, **options)

    return read


@pytest.fixture
def read_with_notes(read):
    """Read, and check that each note is also a warning that names the file."""

    def read_with_notes(text, **options):
        with pytest.warns(MasatWarning) as caught:
            graph = read(text, **options)
        warned = [str(w.message) for w in caught]
        assert len(warned) == len(graph.notes)
        for note, warning in zip(graph.notes, warned, strict=True):
            assert re.fullmatch(r".*graph\.txt: " + re.escape(note), warning)
        return graph

    return read_with_notes


@pytest.fixture
def run(monkeypatch, capsys, tmp_path):
    """Run masat in this process, in a folder of its own: exit code, output, standard error."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments):
        monkeypatch.setattr(sys, "argv", ["masat", *map(str, arguments)])
        with pytest.raises(SystemExit) as stop:
            main()
        out, err = capsys.readouterr()
        return stop.value.code, out, err

    return call
