"""The true graphs of the worlds that MASAT was evaluated on."""

from __future__ import annotations

from functools import cache

from masat.datasets.fetching import load
from masat.datasets.grid import recover_grid_truth
from masat.datasets.registry import check_name
from masat.graph import PoseGraph

GRID_WORLDS: dict[str, str] = {
    "Manhattan3500": "M3500",
    "City10k": "city10k",
    "Manhattan10000": "10kHog-man",
}
"""Names of worlds in the evaluation of the MASAT paper, and the datasets that they come from."""


def ground_truth(name: str) -> PoseGraph:
    """Return the true graph of an evaluation world, recovered from its noisy original.

    It is computed at the first call; later calls return the same graph.

    Parameters
    ----------
    name : str
        One of `GRID_WORLDS`.

    Returns
    -------
    PoseGraph
        The graph that `recover_grid_truth` returns for the dataset: exact poses and measurements,
        identity information. `masat.worlds.perturb` adds noise to it.

    Raises
    ------
    DatasetError
        If the name is unknown, or as from `fetch`.
    """
    check_name("grid world", name, GRID_WORLDS)
    return _recovered(GRID_WORLDS[name])


@cache
def _recovered(dataset: str) -> PoseGraph:
    return recover_grid_truth(load(dataset))
