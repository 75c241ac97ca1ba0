"""From the name of a dataset to its file and its graph."""

from __future__ import annotations

import gzip
import hashlib
import os
import sys
import zlib
from contextlib import nullcontext
from pathlib import Path
from typing import Any

from masat.datasets.errors import DatasetError
from masat.datasets.registry import Dataset, find
from masat.formats import read
from masat.graph import PoseGraph

FOLDER_VARIABLE = "MASAT_DATASETS"
"""Environment variable that names a folder of copies, searched before anything is downloaded."""

_GZIP = b"\x1f\x8b"


def fetch(name: str) -> Path:
    """Return the file of a dataset, downloaded when it is first asked for.

    Downloads are kept in the user's cache. A folder of copies, named by the environment variable
    `MASAT_DATASETS`, comes first: the file may lie there or in its subfolder `2d` or `3d`, gzipped
    or not. Either way its SHA-256 is checked.

    Parameters
    ----------
    name : str
        One of `masat.datasets.names()`.

    Returns
    -------
    Path

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
        Those of `masat.read`: "cubicle" has indefinite matrices and needs `indefinite`.

    Returns
    -------
    PoseGraph

    Raises
    ------
    DatasetError
        As `fetch`.
    FormatError
        As `masat.read`.
    """
    return read(fetch(name), **{"format": find(name).format, **options})


def _copy(dataset: Dataset) -> Path | None:
    """Return the file in the folder of copies, or None if there is neither."""
    named = os.environ.get(FOLDER_VARIABLE)
    if not named:
        return None
    folder = Path(named)
    if not folder.is_dir():
        raise DatasetError(f"{FOLDER_VARIABLE} names {folder}, which is no folder")
    for place in (folder, folder / f"{dataset.dimension}d"):
        for file in (place / dataset.file, place / f"{dataset.file}.gz"):
            if file.is_file():
                _check(file, dataset)
                return file
    return None


def _check(file: Path, dataset: Dataset) -> None:
    try:
        data = file.read_bytes()
        text = gzip.decompress(data) if data.startswith(_GZIP) else data
    except (EOFError, OSError, zlib.error) as error:
        raise DatasetError(f"{file}: cannot be read: {error}") from None
    found = hashlib.sha256(text).hexdigest()
    if found != dataset.sha256:
        raise DatasetError(
            f"{file}: not the file of {dataset.name!r}: its SHA-256 is {found}, expected "
            f"{dataset.sha256}; replace it, or remove it to download the original"
        )


def _download(dataset: Dataset) -> Path:
    # They take longer to import than most graphs to read.
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
            f"cannot download {dataset.name!r} from {dataset.url}: {error}; without network, set "
            f"{FOLDER_VARIABLE} to a folder that holds {dataset.file}"
        ) from error
    except ValueError as error:
        raise DatasetError(f"{dataset.url} is not the file of {dataset.name!r}: {error}") from error
    return Path(file)
