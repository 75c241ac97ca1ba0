"""Simulated worlds: the truth of a robot's walk, and noise for its measurements."""

from __future__ import annotations

from masat.worlds.manhattan import manhattan
from masat.worlds.noise import perturb

__all__ = ["manhattan", "perturb"]
