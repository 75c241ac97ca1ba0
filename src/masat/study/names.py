"""Names of cases and runs: a case is one graph to solve, a run is one method that solves it."""

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
    return ",".join(map(number_name, sigma))


def number_name(number: float) -> str:
    """Return '.35' for 0.35."""
    return f"{number:g}".removeprefix("0") or "0"


@dataclass(frozen=True, order=True)
class Case:
    """One graph to solve.

    Attributes
    ----------
    world : str
        A world, or a real graph: a public one or a file.
    sigma : tuple of float
        The noise level of a world; empty for a real graph.
    instance : int
        Number of the noisy instance of a world, or of the false loop closures of a real graph.
    kind, fraction : str, float
        The kind of the false loop closures that are added, and their fraction of all loop closures
        (`masat.worlds.add_false_closures`); an empty kind for a graph without any.
    """

    world: str
    sigma: Sigma
    instance: int
    kind: str = ""
    fraction: float = 0.0

    @property
    def name(self) -> str:
        """The name of the case: City10k/.35,.35,.35/17 or City10k/.35,.35,.35/alias:.5/17."""
        false = f"{self.kind}:{number_name(self.fraction)}/" if self.kind else ""
        return f"{self.world}/{sigma_name(self.sigma)}/{false}{self.instance}"

    @property
    def seed(self) -> int:
        """Seed of the random numbers: a hash of the name, hence the same in every study."""
        return int.from_bytes(hashlib.sha256(self.name.encode()).digest()[:8], "big")

    @property
    def clean(self) -> Case:
        """The same case without false loop closures."""
        return Case(self.world, self.sigma, self.instance)


def parse_run(name: str) -> tuple[Case, str]:
    """Return the case and the method that a run is named after.

    Parameters
    ----------
    name : str
        WORLD/SIGMAS/INSTANCE/INIT, such as City10k/.35,.35,.35/17/masat, or with false loop
        closures WORLD/SIGMAS/KIND:FRACTION/INSTANCE/METHOD, such as
        City10k/.35,.35,.35/alias:.5/17/robust. SIGMAS is empty for a real graph: MIT//0/masat.

    Raises
    ------
    StudyError
        If the name has another form.
    """
    try:
        # From the end, since the path of a file may have slashes.
        head, before, instance, method = name.rsplit("/", 3)
        kind, fraction = "", "0"
        if ":" in before:
            kind, fraction = before.split(":")
            head, before = head.rsplit("/", 1)
        sigma = tuple(float(s) for s in before.split(",")) if before else ()
        return Case(head, sigma, int(instance), kind, float(fraction)), method
    except ValueError:
        raise StudyError(
            f"{name!r} names no run: expected WORLD/SIGMAS/INSTANCE/INIT, such as "
            "City10k/.35,.35,.35/17/masat, or WORLD/SIGMAS/KIND:FRACTION/INSTANCE/METHOD, such as "
            "City10k/.35,.35,.35/alias:.5/17/robust"
        ) from None
