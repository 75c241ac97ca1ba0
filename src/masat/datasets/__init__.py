"""The public benchmark graphs, fetched by name and checked, and the truth of the grid worlds."""

from __future__ import annotations

from masat.datasets.errors import DatasetError
from masat.datasets.fetching import fetch, load
from masat.datasets.grid import recover_grid_truth
from masat.datasets.registry import DATASETS, Dataset, names
from masat.datasets.truth import GRID_WORLDS, ground_truth

__all__ = [
    "DATASETS",
    "GRID_WORLDS",
    "Dataset",
    "DatasetError",
    "fetch",
    "ground_truth",
    "load",
    "names",
    "recover_grid_truth",
]
