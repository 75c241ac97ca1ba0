"""From the name of a dataset to its file and its graph."""

from __future__ import annotations

import hashlib
import os
import sys
from contextlib import nullcontext
from pathlib import Path
from typing import Any

from masat.datasets.errors import DatasetError
from masat.datasets.registry import Dataset, find
from masat.errors import FormatError
from masat.formats import read
from masat.formats.text import load_text
from masat.graph import PoseGraph

FOLDER_VARIABLE = "MASAT_DATASETS"
"""Environment variable that names a folder of copies, which is searched before a download."""


def fetch(name: str) -> Path:
    """Return the file of a dataset, which is downloaded at the first call.

    Downloads are kept in the user's cache. If the environment variable `MASAT_DATASETS` names a
    folder of copies, the file is first looked for there and in the subfolder `2d` or `3d`,
    compressed by gzip or not. In both cases its SHA-256 is checked.

    Parameters
    ----------
    name : str
        One of `masat.datasets.names()`.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    DatasetError
        If the name is unknown, the file cannot be downloaded, or its checksum is wrong.
    """
    dataset = find(name)
    return _copy(dataset) or _download(dataset)


def load(name: str, **options: Any) -> PoseGraph:
    """Fetch and read a dataset.

    Parameters
    ----------
    name : str
        One of `masat.datasets.names()`.
    **options
        Options of `masat.read`. The dataset "cubicle" has indefinite information matrices and
        needs `indefinite`.

    Returns
    -------
    PoseGraph

    Raises
    ------
    DatasetError
        As from `fetch`.
    FormatError
        As from `masat.read`.
    """
    return read(fetch(name), **{"format": find(name).format, **options})


def _copy(dataset: Dataset) -> Path | None:
    """Return the file in the folder of copies; None if there is no such folder or file."""
    named = os.environ.get(FOLDER_VARIABLE)
    if not named:
        return None
    folder = Path(named)
    if not folder.is_dir():
        raise DatasetError(f"{FOLDER_VARIABLE} names {folder}, which is not a folder")
    for parent in (folder, folder / f"{dataset.dimension}d"):
        for file in (parent / dataset.file, parent / f"{dataset.file}.gz"):
            if file.is_file():
                _check(file, dataset)
                return file
    return None


def _check(file: Path, dataset: Dataset) -> None:
    try:
        text = load_text(file)
    except FormatError as error:
        raise DatasetError(str(error)) from None
    except OSError as error:
        raise DatasetError(f"{file}: cannot be read: {error}") from None
    found = hashlib.sha256(text).hexdigest()
    if found != dataset.sha256:
        raise DatasetError(
            f"{file}: not the file of {dataset.name!r}: its SHA-256 is {found}, expected "
            f"{dataset.sha256}; replace it, or remove it to download the original"
        )


def _download(dataset: Dataset) -> Path:
    # These modules take longer to import than most graphs take to read.
    import pooch

    from masat.datasets.progress import Bar

    pooch.get_logger().setLevel("WARNING")
    try:
        with Bar(dataset.name) if sys.stderr.isatty() else nullcontext() as bar:
            file = pooch.retrieve(
                dataset.url,
                known_hash=f"sha256:{dataset.sha256}",
                fname=dataset.file,
                path=pooch.os_cache("masat"),
                progressbar=bar or False,
            )
    except OSError as error:
        raise DatasetError(
            f"cannot download {dataset.name!r} from {dataset.url}: {error}; without a network, set "
            f"{FOLDER_VARIABLE} to a folder that holds {dataset.file}"
        ) from error
    except ValueError as error:
        raise DatasetError(f"{dataset.url} is not the file of {dataset.name!r}: {error}") from error
    return Path(file)
