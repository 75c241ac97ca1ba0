"""The table `registry.toml`: all datasets, their sources and their sizes."""

from __future__ import annotations

import tomllib
from collections.abc import Collection
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from masat.datasets.errors import DatasetError

_HOST = "https://raw.githubusercontent.com"
_TABLE = Path(__file__).with_name("registry.toml")


@dataclass(frozen=True)
class Dataset:
    """A file with a pose graph, at one commit of a public repository.

    Attributes
    ----------
    name : str
        Name for `masat.datasets.fetch`.
    repository, commit, path : str
        OWNER/NAME on GitHub, the commit, and the path of the file in the repository.
    license : str
        License of the repository as a whole; none states one for its data.
    file : str
        Name of the file in a folder of copies; the name in `path` if that is unique.
    sha256 : str
        Checksum of the decompressed file.
    dimension : int
        2 or 3.
    nodes, edges : int
        Number of nodes and of edges.
    format : str or None
        One of `masat.formats.FORMATS` if the tags of the file fit several.
    """

    name: str
    repository: str
    commit: str
    path: str
    license: str
    file: str
    sha256: str
    dimension: int
    nodes: int
    edges: int
    format: str | None = None

    @property
    def url(self) -> str:
        """Address of the file."""
        return f"{_HOST}/{self.repository}/{self.commit}/{self.path}"


def _datasets() -> dict[str, Dataset]:
    table: dict[str, Any] = tomllib.loads(_TABLE.read_text("utf-8"))
    return {
        name: Dataset(name=name, **table["sources"][entry.pop("source")], **entry)
        for name, entry in table["graphs"].items()
    }


DATASETS: dict[str, Dataset] = _datasets()


def names() -> tuple[str, ...]:
    """Return the names of all datasets, those in 2D first."""
    return tuple(DATASETS)


def find(name: str) -> Dataset:
    """Return the dataset with a name; an unknown name is a DatasetError."""
    check_name("dataset", name, DATASETS)
    return DATASETS[name]


def check_name(what: str, name: object, known: Collection[str]) -> None:
    """Refuse an unknown name; the error lists the known names that are similar to it."""
    if not isinstance(name, str):
        raise DatasetError(f"the name of a {what} must be a string, got {name!r}")
    if name in known:
        return
    folded = {each.casefold(): each for each in known}
    close = get_close_matches(name.casefold(), folded, n=5, cutoff=0.5)
    listed = "similar names" if close else "known"
    names = ", ".join(folded[c] for c in close or folded)
    raise DatasetError(f"unknown {what} {name!r}; {listed}: {names}")
