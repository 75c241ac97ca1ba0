"""Names of cases and runs: a case is one graph to solve, a run is one initial guess for it."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

from masat.errors import MasatError


class StudyError(MasatError, ValueError):
    """A study cannot be run, resumed or reported as asked."""


Sigma = tuple[float, ...]
"""A noise level: standard deviations as `masat.worlds.perturb` takes them; empty for no noise."""


def sigma_name(sigma: Sigma) -> str:
    """Return '.35,.35,.35' for (0.35, 0.35, 0.35)."""
    return ",".join(f"{s:g}".removeprefix("0") or "0" for s in sigma)


@dataclass(frozen=True, order=True)
class Case:
    """A noisy instance of a world or, with an empty noise level, a real graph as it is."""

    world: str
    sigma: Sigma
    instance: int

    @property
    def name(self) -> str:
        """The name of the case, such as City10k/.35,.35,.35/17."""
        return f"{self.world}/{sigma_name(self.sigma)}/{self.instance}"

    @property
    def seed(self) -> int:
        """Seed of the instance's noise: a hash of the name, hence the same in every study."""
        return int.from_bytes(hashlib.sha256(self.name.encode()).digest()[:8], "big")


def parse_run(name: str) -> tuple[Case, str]:
    """Return the case and the initial guess that a run is named after.

    Parameters
    ----------
    name : str
        WORLD/SIGMAS/INSTANCE/INIT, such as City10k/.35,.35,.35/17/masat; SIGMAS is empty for a
        real graph: MIT//0/masat.

    Raises
    ------
    StudyError
        If the name has another form.
    """
    parts = name.split("/")
    try:
        world, sigmas, instance, init = parts
        sigma = tuple(float(s) for s in sigmas.split(",")) if sigmas else ()
        return Case(world, sigma, int(instance)), init
    except ValueError:
        raise StudyError(
            f"{name!r} names no run: expected WORLD/SIGMAS/INSTANCE/INIT, such as "
            "City10k/.35,.35,.35/17/masat"
        ) from None
