"""The design of a study: graphs, and the initial guesses or methods that are compared on them."""

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

    A study compares either initial guesses or, if it has `methods`, these on graphs with false loop
    closures.

    Attributes
    ----------
    worlds : tuple of str
        The paper's worlds, or simulated ones such as sphere:500:1000 (NAME:NODES:EDGES).
    sigmas : tuple of tuple of float
        Noise levels: standard deviations in meters and radians. Three are those of x, y and theta
        for worlds in 2D; two (translation, rotation) or six (x, y, z, and the rotation about x, y
        and z) are for worlds in 3D. A world takes the levels that fit its dimension.
    instances : int
        Number of noisy instances of each world at each of its levels. With `methods`, each instance
        also has false loop closures of its own, and so do those of the real graphs.
    inits : tuple of str
        Initial guesses, of `INITS`.
    max_iterations : int
        Largest number of iterations of an optimization: of Gauss-Newton from an initial guess.
    graphs : tuple of str
        Real graphs, by their names in `masat.datasets` or by paths of files, which have a slash.
        Each is solved once from each initial guess except the ground truth.
    kinds : tuple of str
        Kinds of false loop closures (`masat.worlds.add_false_closures`).
    fractions : tuple of float
        Fractions of the false among all loop closures.
    methods : tuple of str
        Methods against false loop closures (`masat.study.robust_methods.METHODS`).
    title : str
        Title of the report.
    """

    worlds: tuple[str, ...]
    sigmas: tuple[Sigma, ...]
    instances: int
    inits: tuple[str, ...] = ()
    max_iterations: int = 50
    graphs: tuple[str, ...] = ()
    kinds: tuple[str, ...] = ()
    fractions: tuple[float, ...] = ()
    methods: tuple[str, ...] = ()
    title: str = ""

    @property
    def columns(self) -> tuple[str, ...]:
        """What the study compares: initial guesses or methods."""
        return self.methods or self.inits

    def levels_of(self, world: str) -> tuple[Sigma, ...]:
        """Return the noise levels that fit the dimension of a world."""
        sizes = LEVEL_SIZES[dimension_of(world)]
        return tuple(level for level in self.sigmas if len(level) in sizes)

    def cases(self) -> list[Case]:
        """Return all cases, instance by instance, so that a stopped study covers all cells."""
        noisy = [(world, sigma) for world in self.worlds for sigma in self.levels_of(world)]
        real: list[tuple[str, Sigma]] = [(graph, ()) for graph in self.graphs]
        numbers = range(self.instances)
        if self.methods:
            return [
                Case(world, sigma, k, kind, fraction)
                for k in numbers
                for world, sigma in noisy + real
                for kind in self.kinds
                for fraction in self.fractions
            ]
        return [Case(*cell, k) for k in numbers for cell in noisy] + [Case(*g, 0) for g in real]

    def columns_of(self, case: Case) -> tuple[str, ...]:
        """Return what is compared on a case; a real graph has no ground truth to begin from."""
        return tuple(c for c in self.columns if case.sigma or c != GROUND_TRUTH)

    def runs(self) -> int:
        """Return the number of all runs, without listing them."""
        noisy = sum(len(self.levels_of(world)) for world in self.worlds)
        if self.methods:
            spoiled = len(self.kinds) * len(self.fractions)
            return self.instances * (noisy + len(self.graphs)) * spoiled * len(self.methods)
        real = len(self.graphs) * len(self.columns_of(Case("", (), 0)))
        return self.instances * noisy * len(self.inits) + real

    def to_table(self) -> dict[str, Any]:
        """Return the keys of a design file with their values."""
        table: dict[str, Any] = json.loads(json.dumps(asdict(self)))
        return table
