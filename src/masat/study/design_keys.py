"""Checking the keys of a design, so that an error names the file and the line."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from masat.datasets import DatasetError
from masat.datasets.registry import find
from masat.study.design import INITS, LEVEL_SIZES, Design
from masat.study.names import Sigma, StudyError, sigma_name
from masat.study.robust_methods import METHODS
from masat.study.toml_lines import TomlText
from masat.study.worlds import dimension_of, is_path
from masat.worlds.false_closures import KINDS

# The limits below only catch typing errors: they are far above what can be run and kept.
_MAX_RUNS = 1_000_000
_MAX_ITERATIONS = 10_000
# The information 1 / sigma^2 and chi2 then stay far from the limits of floating point.
_SIGMA_RANGE = (1e-9, 1e6)
_MAX_TITLE = 200

_LEVEL_HELP = (
    "[x, y, theta] in 2D, [translation, rotation] or six sigmas in 3D, in meters and radians, "
    "such as [0.1, 0.1, 0.05]"
)


def check_design(table: dict[str, Any], text: TomlText) -> Design:
    """Return the design that a table of keys describes.

    Parameters
    ----------
    table : dict
        The keys of a design file.
    text : TomlText
        Where the table comes from.

    Raises
    ------
    StudyError
        If a key is unknown, missing or has a wrong value.
    """
    keys = tuple(Design.__dataclass_fields__)
    for key in table:
        if key == "starts":
            raise text.error("the key 'starts' is now called 'inits'", key)
        if key not in keys:
            raise text.error(f"unknown key {key!r}; known: {', '.join(keys)}", key)
    graphs = _graphs(table, text)
    worlds = _names(table, text, "worlds", empty=bool(graphs))
    dimensions = []
    for k, world in enumerate(worlds):
        try:
            dimensions.append(dimension_of(world))
        except StudyError as error:
            raise text.error(str(error), "worlds", k) from None
    kinds, fractions, methods = _false_closures(table, text)
    if methods and table.get("inits"):
        raise text.error("a study compares either inits or methods: leave out one of them", "inits")
    inits = _known(table, text, "inits", "initial guess", INITS, empty=bool(methods))
    levels = _levels(table, text, needed=bool(worlds))
    _check_dimensions(worlds, dimensions, levels, text)
    design = Design(
        worlds=worlds,
        sigmas=levels,
        instances=_count(table, text, "instances", None if worlds or methods else 1, _MAX_RUNS),
        inits=inits,
        max_iterations=_count(table, text, "max_iterations", 50, _MAX_ITERATIONS),
        graphs=graphs,
        kinds=kinds,
        fractions=fractions,
        methods=methods,
        title=_title(table, text),
    )
    if design.runs() > _MAX_RUNS:
        raise text.error(
            f"the design has {design.runs():,} runs; at most {_MAX_RUNS:,} are possible",
            "instances",
        )
    if design.runs() == 0:
        raise text.error("real graphs have no ground truth: name another initial guess", "inits")
    return design


def _names(
    table: dict[str, Any], text: TomlText, key: str, *, empty: bool = False
) -> tuple[str, ...]:
    values = table.get(key, [])
    if not isinstance(values, list) or not all(isinstance(v, str) for v in values):
        raise text.error(f'{key} must be a list of names, such as ["a", "b"]', key)
    if not values and not empty:
        raise text.error(f"{key} is missing or empty", key)
    for k, value in enumerate(values):
        if value in values[:k]:
            raise text.error(f"{value!r} is named twice in {key}", key, k)
    return tuple(values)


def _known(
    table: dict[str, Any],
    text: TomlText,
    key: str,
    what: str,
    known: Iterable[str],
    *,
    empty: bool = False,
) -> tuple[str, ...]:
    """Return the names of a key, each of which must be among the known ones."""
    names = _names(table, text, key, empty=empty)
    for k, name in enumerate(names):
        if name not in known:
            raise text.error(f"unknown {what} {name!r}; known: {', '.join(known)}", key, k)
    return names


def _graphs(table: dict[str, Any], text: TomlText) -> tuple[str, ...]:
    graphs = _names(table, text, "graphs", empty=True)
    for k, graph in enumerate(graphs):
        try:
            # Whether a file is there is a question for the moment when the study runs.
            if not is_path(graph):
                find(graph)
        except DatasetError as error:
            help_ = "" if "." not in graph else "; the path of a file has a slash, such as ./a.g2o"
            raise text.error(f"{error}{help_}", "graphs", k) from None
    return graphs


def _false_closures(
    table: dict[str, Any], text: TomlText
) -> tuple[tuple[str, ...], tuple[float, ...], tuple[str, ...]]:
    """Return kinds, fractions and methods, all of them or none."""
    keys = ("kinds", "fractions", "methods")
    given = [key for key in keys if table.get(key)]
    if not given:
        return (), (), ()
    for key in keys:
        if key not in given:
            raise text.error(
                f"{key} is missing or empty: a study of false loop closures needs "
                f"{', '.join(keys)}",
                key,
            )
    kinds = _known(table, text, "kinds", "kind of false loop closures", KINDS)
    methods = _known(table, text, "methods", "method", METHODS)
    return kinds, _fractions(table, text), methods


def _fractions(table: dict[str, Any], text: TomlText) -> tuple[float, ...]:
    values = table["fractions"]
    if not isinstance(values, list):
        raise text.error("fractions must be a list of numbers, such as [0.1, 0.5]", "fractions")
    for k, value in enumerate(values):
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if not number or not 0 <= value < 1:
            raise text.error(
                f"a fraction must be a number of at least 0 and below 1, got {_short(value)}",
                "fractions",
                k,
            )
        if float(f"{value:g}") != value:
            raise text.error(
                f"a fraction must have at most six digits, since it names the runs: write "
                f"{value:g} for {value!r}",
                "fractions",
                k,
            )
        if value in values[:k]:
            raise text.error(f"the fraction {value:g} is given twice", "fractions", k)
    return tuple(float(value) for value in values)


def _count(
    table: dict[str, Any], text: TomlText, key: str, default: int | None, largest: int
) -> int:
    value = table.get(key, default)
    if value is None:
        raise text.error(f"{key} must be given: a positive integer")
    if not isinstance(value, int) or isinstance(value, bool) or value < 1:
        raise text.error(f"{key} must be a positive integer, got {_short(value)}", key)
    if value > largest:
        raise text.error(f"{key} must be at most {largest:,}, got {_short(value)}", key)
    return value


def _title(table: dict[str, Any], text: TomlText) -> str:
    title = table.get("title", "")
    if not isinstance(title, str) or len(title) > _MAX_TITLE or not (title + "x").isprintable():
        raise text.error(f"title must be a line of at most {_MAX_TITLE} characters", "title")
    return title


def _levels(table: dict[str, Any], text: TomlText, *, needed: bool) -> tuple[Sigma, ...]:
    levels = table.get("sigmas", [])
    if not isinstance(levels, list) or (needed and not levels):
        raise text.error(f"sigmas must be a list of noise levels: {_LEVEL_HELP}", "sigmas")
    sizes = [size for sizes in LEVEL_SIZES.values() for size in sizes]
    low, high = _SIGMA_RANGE
    found: list[Sigma] = []
    for k, level in enumerate(levels):
        if not isinstance(level, list) or len(level) not in sizes:
            raise text.error(f"a noise level is {_LEVEL_HELP}; got {_short(level)}", "sigmas", k)
        for j, sigma in enumerate(level):
            if not isinstance(sigma, int | float) or isinstance(sigma, bool):
                raise text.error(f"a sigma must be a number, got {_short(sigma)}", "sigmas", k, j)
            if sigma != 0 and not low <= sigma <= high:
                raise text.error(
                    f"a sigma must be 0 or from {low:g} to {high:g}, and not negative, got "
                    f"{_short(sigma)}",
                    "sigmas",
                    k,
                    j,
                )
            if float(f"{sigma:g}") != sigma:
                raise text.error(
                    f"a sigma must have at most six digits, since it names the runs: write "
                    f"{sigma:g} for {sigma!r}",
                    "sigmas",
                    k,
                    j,
                )
        sigmas = tuple(float(s) for s in level)
        if sigmas in found:
            raise text.error(f"the noise level {_short(level)} is given twice", "sigmas", k)
        found.append(sigmas)
    return tuple(found)


def _check_dimensions(
    worlds: tuple[str, ...], dimensions: list[int], levels: tuple[Sigma, ...], text: TomlText
) -> None:
    """Refuse worlds without a noise level for their dimension, and levels without a world."""
    for k, (world, dimension) in enumerate(zip(worlds, dimensions, strict=True)):
        if not any(len(level) in LEVEL_SIZES[dimension] for level in levels):
            sizes = " or ".join(map(str, LEVEL_SIZES[dimension]))
            raise text.error(
                f"the world {world!r} is in {dimension}D and no noise level has {sizes} sigmas: a "
                f"noise level is {_LEVEL_HELP}",
                "worlds",
                k,
            )
    taken = {size for dimension in dimensions for size in LEVEL_SIZES[dimension]}
    for k, level in enumerate(levels):
        if len(level) not in taken:
            fits = next(d for d, sizes in LEVEL_SIZES.items() if len(level) in sizes)
            raise text.error(
                f"the noise level [{sigma_name(level)}] has {len(level)} sigmas and fits worlds in "
                f"{fits}D only, of which the design has none",
                "sigmas",
                k,
            )


def _short(value: object) -> str:
    """Return a value as text, cut where it is long."""
    try:
        text = repr(value)
    except ValueError:  # an integer of thousands of digits
        return "an integer of thousands of digits"
    return text if len(text) <= 60 else f"{text[:57]}..."
