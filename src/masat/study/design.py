"""The design of a study: worlds x noise levels x instances x starts, in one TOML file."""

from __future__ import annotations

import json
import math
import tomllib
from dataclasses import asdict, dataclass
from importlib import resources
from pathlib import Path
from typing import Any

from masat.initializers import INITIALIZERS
from masat.study.names import Case, Sigma, StudyError
from masat.study.worlds import GROUND_TRUTH, check_world

STARTS = [*(name for name in INITIALIZERS if name != "given"), GROUND_TRUTH]


@dataclass(frozen=True)
class Design:
    """What a study runs.

    Attributes
    ----------
    worlds : tuple of str
        The paper's worlds, or simulated ones as name:nodes:edges.
    sigmas : tuple of tuple of float
        Noise levels: standard deviations of x, y (meters) and theta (radians).
    instances : int
        Noisy instances of each world at each level.
    starts : tuple of str
        Initial guesses, and "ground_truth".
    max_iterations : int
        Of Gauss-Newton.
    graphs : tuple of str
        Real graphs, by their names in `masat.datasets`, solved once from each start but the truth.
    """

    worlds: tuple[str, ...]
    sigmas: tuple[Sigma, ...]
    instances: int
    starts: tuple[str, ...]
    max_iterations: int = 50
    graphs: tuple[str, ...] = ()

    def cases(self) -> list[Case]:
        """Return all cases, instance by instance, so that a study cut short covers all cells."""
        noisy = [
            Case(world, sigma, k)
            for k in range(self.instances)
            for world in self.worlds
            for sigma in self.sigmas
        ]
        return noisy + [Case(graph, (), 0) for graph in self.graphs]

    def starts_of(self, case: Case) -> tuple[str, ...]:
        """Return the starts of a case; a real graph has no ground truth."""
        return tuple(s for s in self.starts if case.sigma or s != GROUND_TRUTH)

    def to_json(self) -> str:
        """Return the design as text; equal designs have equal texts."""
        return json.dumps(asdict(self), sort_keys=True)

    @classmethod
    def from_json(cls, text: str) -> Design:
        """Return the design of a text that `to_json` made."""
        table: dict[str, Any] = json.loads(text)
        table["sigmas"] = tuple(tuple(level) for level in table["sigmas"])
        for name in ("worlds", "starts", "graphs"):
            table[name] = tuple(table[name])
        return cls(**table)


def shipped() -> list[str]:
    """Return the names of the designs that come with the package."""
    folder = resources.files("masat.study") / "designs"
    return sorted(p.name.removesuffix(".toml") for p in folder.iterdir())


def load_design(name: str) -> Design:
    """Read a design by the name of one that comes with the package, or from a file.

    Raises
    ------
    StudyError
        Naming the file and the line of what is wrong.
    """
    if name in shipped():
        path = f"{name}.toml"
        text = (resources.files("masat.study") / "designs" / path).read_text("utf-8")
    else:
        path = name
        if not Path(name).is_file():
            raise StudyError(f"{name}: no such design; shipped: {', '.join(shipped())}, or a file")
        text = Path(name).read_text("utf-8")
    try:
        return _checked(tomllib.loads(text), text, path)
    except tomllib.TOMLDecodeError as error:
        raise StudyError(f"{path}: {error}") from None


def _checked(table: dict[str, Any], text: str, path: str) -> Design:
    def refuse(what: str, *tokens: str) -> StudyError:
        """Blame the first line that holds a token, the earlier tokens first."""
        lines = text.splitlines()
        for token in tokens:
            for number, line in enumerate(lines, 1):
                if token in line.split("#")[0]:
                    return StudyError(f"{path}:{number}: {what}")
        return StudyError(f"{path}: {what}")

    fields = set(Design.__dataclass_fields__)
    for key in table:
        if key not in fields:
            raise refuse(f"unknown key {key!r}; known: {', '.join(sorted(fields))}", key)

    def names(key: str, *, empty: bool = False) -> tuple[str, ...]:
        values = table.get(key, [])
        if not isinstance(values, list) or not all(isinstance(v, str) for v in values):
            raise refuse(f"{key} must be a list of names", key)
        if not values and not empty:
            raise refuse(f"{key} is missing or empty", key)
        for k, value in enumerate(values):
            if value in values[:k]:
                raise refuse(f"{value!r} is named twice in {key}", f'"{value}"', key)
        return tuple(values)

    def count(key: str, default: int | None = None) -> int:
        value = table.get(key, default)
        if not isinstance(value, int) or isinstance(value, bool) or value < 1:
            raise refuse(f"{key} must be a positive integer, got {value!r}", key)
        return value

    graphs = names("graphs", empty=True)
    worlds = names("worlds", empty=bool(graphs))
    for world in worlds:
        try:
            check_world(world)
        except StudyError as error:
            raise refuse(str(error), f'"{world}"', "worlds") from None
    starts = names("starts")
    for start in starts:
        if start not in STARTS:
            raise refuse(f"unknown start {start!r}; known: {', '.join(STARTS)}", f'"{start}"')
    sigmas = table.get("sigmas", [])
    if worlds and (not isinstance(sigmas, list) or not sigmas):
        raise refuse("sigmas must be a list of noise levels, such as [0.1, 0.1, 0.1]", "sigmas")
    for level in sigmas:
        if not isinstance(level, list) or len(level) != 3:
            raise refuse(f"a noise level has sigmas of x, y and theta, got {level}", "sigmas")
        for sigma in level:
            numeric = isinstance(sigma, int | float) and not isinstance(sigma, bool)
            if not numeric or not math.isfinite(sigma) or sigma < 0:
                raise refuse(
                    f"a sigma must be a number and not negative, got {sigma!r}",
                    str(sigma),
                    "sigmas",
                )
    return Design(
        worlds=worlds,
        sigmas=tuple(tuple(float(s) for s in level) for level in sigmas),
        instances=count("instances", None if worlds else 1),
        starts=starts,
        max_iterations=count("max_iterations", 50),
        graphs=graphs,
    )
