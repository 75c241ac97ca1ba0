"""Simulated worlds: the true graph of a robot's walk, and what is added to it.

Added are noise, false loop closures, position fixes and landmarks.

A world is one file in this folder and one line of `WORLDS`.
"""

from __future__ import annotations

from collections.abc import Callable

from masat.graph import PoseGraph
from masat.worlds.city import city
from masat.worlds.false_closures import add_false_closures, normalized
from masat.worlds.fixes import add_fixes
from masat.worlds.garage import garage
from masat.worlds.grid import grid
from masat.worlds.landmarks import add_landmarks
from masat.worlds.manhattan import manhattan
from masat.worlds.noise import perturb
from masat.worlds.sphere import sphere
from masat.worlds.torus import torus

WORLDS: dict[str, Callable[..., PoseGraph]] = {
    "manhattan": manhattan,
    "city": city,
    "sphere": sphere,
    "torus": torus,
    "grid": grid,
    "garage": garage,
}
"""Functions of (nodes, edges, seed=0); the default sizes are those of public graphs."""

__all__ = [
    "WORLDS",
    "add_false_closures",
    "add_fixes",
    "add_landmarks",
    "city",
    "garage",
    "grid",
    "manhattan",
    "normalized",
    "perturb",
    "sphere",
    "torus",
]
