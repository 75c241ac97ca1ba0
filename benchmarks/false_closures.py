"""The loop closures that a place recognizer proposed on KITTI, each labeled as true or false.

Source: Latif, Cadena, Neira, Robust loop closing over time for pose graph SLAM, IJRR 2013.
"""

from __future__ import annotations

import numpy as np

import masat
from benchmarks.data import DATA
from masat.arrays import Flags
from masat.chain import odometry_edges

FOLDER = DATA / "false_closures"


def labeled_names() -> list[str]:
    """Return the names of the labeled graphs, such as kitti_00_alpha_0.50."""
    return sorted(path.name.removesuffix("_true.txt") for path in FOLDER.glob("*_true.txt"))


def labeled(name: str) -> tuple[masat.PoseGraph, Flags]:
    """Return a labeled graph, and which of its edges are true: odometry and the true closures."""
    graph = masat.read(FOLDER / f"{name}.g2o.gz")
    text = (FOLDER / f"{name}_true.txt").read_text()
    true_pairs = {(int(a), int(b)) for a, b in (line.split() for line in text.splitlines())}
    pairs = [(a, b) for a, b in graph.edges.tolist()]
    missing = true_pairs.difference(pairs)
    if missing:
        raise ValueError(f"{name}: the graph has no loop closure {min(missing)}")
    return graph, odometry_edges(graph) | np.array([pair in true_pairs for pair in pairs])
