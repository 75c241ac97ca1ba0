import os
from pathlib import Path

import pytest
from hypothesis import settings

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
