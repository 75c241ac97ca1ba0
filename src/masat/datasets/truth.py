"""The truths of the worlds that MASAT was evaluated on."""

from __future__ import annotations

from functools import cache

from masat.datasets.fetching import load
from masat.datasets.grid import recover_grid_truth
from masat.datasets.registry import unknown
from masat.graph import PoseGraph

GRID_WORLDS: dict[str, str] = {
    "Manhattan3500": "M3500",
    "City10k": "city10k",
    "Manhattan10000": "10kHog-man",
}
"""The names in the evaluation of the MASAT paper, and the datasets that the worlds come from."""


@cache
def ground_truth(name: str) -> PoseGraph:
    """Return the truth of an evaluation world, recovered from its noisy original and remembered.

    Parameters
    ----------
    name : str
        One of `GRID_WORLDS`.

    Returns
    -------
    PoseGraph
        Exact poses and measurements, identity information: `recover_grid_truth` of the dataset.
        Make noisy instances with `masat.worlds.perturb`.

    Raises
    ------
    DatasetError
        If the name is unknown, or as `fetch`.
    """
    if name not in GRID_WORLDS:
        raise unknown("grid world", name, GRID_WORLDS)
    return recover_grid_truth(load(GRID_WORLDS[name]))
