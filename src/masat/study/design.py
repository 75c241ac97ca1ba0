"""The design of a study: worlds x noise levels x instances x initial guesses, and real graphs."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import Any

from masat.initializers import INITIALIZERS
from masat.study.names import Case, Sigma
from masat.study.worlds import GROUND_TRUTH, dimension_of

INITS = (*(name for name in INITIALIZERS if name != "given"), GROUND_TRUTH)
"""The initial guesses that a design may name."""

LEVEL_SIZES = {2: (3,), 3: (2, 6)}
"""How many sigmas a noise level has, by the dimension of the worlds that take it."""


@dataclass(frozen=True)
class Design:
    """What a study runs; docs/studies.md describes the keys of a design file.

    Attributes
    ----------
    worlds : tuple of str
        The paper's worlds, or simulated ones such as sphere:500:1000 (NAME:NODES:EDGES).
    sigmas : tuple of tuple of float
        Noise levels: standard deviations in meters and radians. Three are those of x, y and theta
        for worlds in 2D; two (translation, rotation) or six (x, y, z, and the rotation about x, y
        and z) are for worlds in 3D. A world takes the levels that fit its dimension.
    instances : int
        Number of noisy instances of each world at each of its levels.
    inits : tuple of str
        Initial guesses, of `INITS`.
    max_iterations : int
        Largest number of Gauss-Newton iterations.
    graphs : tuple of str
        Real graphs, by their names in `masat.datasets`, solved once from each initial guess except
        the ground truth.
    title : str
        Title of the report.
    """

    worlds: tuple[str, ...]
    sigmas: tuple[Sigma, ...]
    instances: int
    inits: tuple[str, ...]
    max_iterations: int = 50
    graphs: tuple[str, ...] = ()
    title: str = ""

    def levels_of(self, world: str) -> tuple[Sigma, ...]:
        """Return the noise levels that fit the dimension of a world."""
        sizes = LEVEL_SIZES[dimension_of(world)]
        return tuple(level for level in self.sigmas if len(level) in sizes)

    def cases(self) -> list[Case]:
        """Return all cases, instance by instance, so that a stopped study covers all cells."""
        noisy = [
            Case(world, sigma, k)
            for k in range(self.instances)
            for world in self.worlds
            for sigma in self.levels_of(world)
        ]
        return noisy + [Case(graph, (), 0) for graph in self.graphs]

    def inits_of(self, case: Case) -> tuple[str, ...]:
        """Return the initial guesses of a case; a real graph has no ground truth."""
        return tuple(i for i in self.inits if case.sigma or i != GROUND_TRUTH)

    def runs(self) -> int:
        """Return the number of all runs, without listing them."""
        noisy = self.instances * sum(len(self.levels_of(world)) for world in self.worlds)
        return noisy * len(self.inits) + len(self.graphs) * len(self.inits_of(Case("", (), 0)))

    def to_table(self) -> dict[str, Any]:
        """Return the keys of a design file with their values."""
        table: dict[str, Any] = json.loads(json.dumps(asdict(self)))
        return table
