"""What all bridges share: loading the other package, and saying what it cannot hold."""

from __future__ import annotations

import importlib
import warnings
from typing import Any

from masat.errors import GraphError, MasatError, MasatWarning
from masat.graph import PoseGraph


def package(name: str, extra: str) -> Any:
    """Import a package that masat does not need otherwise.

    Raises
    ------
    MasatError
        If it is not installed. The message says how to install it.
    """
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name != name.split(".")[0]:
            raise
        raise MasatError(
            f'this bridge needs the package {name}: pip install "masat[{extra}]"'
        ) from None


def refuse(graph: PoseGraph, other: str, *parts: str) -> None:
    """Refuse a graph that has priors or landmarks, if the other package cannot hold these parts.

    They take part in chi2, so the other package would solve another problem without them.
    """
    for part in parts:
        if getattr(graph, part) is not None:
            raise GraphError(
                f"{other} cannot hold the {part} of this graph as masat defines them: remove them "
                f"with graph.with_{part}(None), or keep the graph in masat"
            )


def warn_left_out(graph: PoseGraph, other: str, *parts: str) -> None:
    """Warn of stamps or labels that a graph has and the other package has no field for."""
    names = {"stamps": "stamps of the nodes", "labels": "labels of the edges"}
    for part in parts:
        if getattr(graph, part) is not None:
            warnings.warn(
                f"{other} has no field for the {names[part]}: they are left out",
                MasatWarning,
                stacklevel=3,
            )
