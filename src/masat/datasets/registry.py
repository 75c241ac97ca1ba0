"""Which graphs there are, where they lie, and what they hold: the table `registry.toml`."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable
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
        What `masat.datasets.fetch` calls it.
    repository, commit, path : str
        GitHub's OWNER/NAME, the commit, and the path of the file there.
    license : str
        What the repository states for itself as a whole; none has one for its data.
    file : str
        Name of the file in a folder of copies; that of `path` where it is unique.
    sha256 : str
        Checksum of the file, uncompressed.
    dimension : int
        2 or 3.
    nodes, edges : int
        How many.
    format : str or None
        One of `masat.formats.FORMATS` where the tags leave it open.
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
        """Where the file is fetched from."""
        return f"{_HOST}/{self.repository}/{self.commit}/{self.path}"


def _datasets() -> dict[str, Dataset]:
    table: dict[str, Any] = tomllib.loads(_TABLE.read_text("utf-8"))
    return {
        name: Dataset(name=name, **table["sources"][entry.pop("source")], **entry)
        for name, entry in table["graphs"].items()
    }


DATASETS: dict[str, Dataset] = _datasets()


def names() -> tuple[str, ...]:
    """Return the names of all datasets, planar ones first."""
    return tuple(DATASETS)


def find(name: str) -> Dataset:
    """Return the dataset of a name; an unknown one is a DatasetError."""
    if name not in DATASETS:
        raise unknown("dataset", name, DATASETS)
    return DATASETS[name]


def unknown(what: str, name: str, known: Iterable[str]) -> DatasetError:
    """Return the error for an unknown name, with the known ones that are close to it."""
    folded = {each.casefold(): each for each in known}
    close = get_close_matches(name.casefold(), folded, n=5, cutoff=0.5)
    listed = "close to it" if close else "known"
    those = ", ".join(folded[c] for c in close or folded)
    return DatasetError(f"unknown {what} {name!r}; {listed}: {those}")
