"""What is run: a case is a noisy instance of a world, or a real graph; a run is a start from it."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

from masat.errors import MasatError


class StudyError(MasatError, ValueError):
    """A study cannot be run, resumed or reported as asked."""


Sigma = tuple[float, ...]


def sigma_name(sigma: Sigma) -> str:
    """Return '.35,.35,.35' for (0.35, 0.35, 0.35)."""
    return ",".join(f"{s:g}".removeprefix("0") or "0" for s in sigma)


@dataclass(frozen=True, order=True)
class Case:
    """A noisy instance of a world, or (with no sigma) a real graph as it is."""

    world: str
    sigma: Sigma
    instance: int

    @property
    def name(self) -> str:
        """Such as City10k/.35,.35,.35/17."""
        return f"{self.world}/{sigma_name(self.sigma)}/{self.instance}"

    @property
    def seed(self) -> int:
        """Of the instance's noise: a hash of its name, the same in any study."""
        return int.from_bytes(hashlib.sha256(self.name.encode()).digest()[:8], "big")


def parse_run(name: str) -> tuple[Case, str]:
    """Return the case and the start of a run's name, such as City10k/.35,.35,.35/17/masat."""
    parts = name.split("/")
    try:
        world, sigmas, instance, start = parts
        sigma = tuple(float(s) for s in sigmas.split(",")) if sigmas else ()
        return Case(world, sigma, int(instance)), start
    except ValueError:
        raise StudyError(
            f"{name!r} names no run: expected WORLD/SIGMAS/INSTANCE/START, such as "
            "City10k/.35,.35,.35/17/masat"
        ) from None
