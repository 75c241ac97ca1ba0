"""Initial guesses; a method is one file here and one line of `INITIALIZERS`."""

from __future__ import annotations

import warnings
from typing import Protocol

from masat.errors import InitializationError, MasatWarning
from masat.graph import PoseGraph
from masat.initializers.auto import auto
from masat.initializers.cauchy import cauchy
from masat.initializers.chordal import chordal
from masat.initializers.given import given
from masat.initializers.lago import lago
from masat.initializers.lifted import lifted
from masat.initializers.masat import masat
from masat.initializers.most_informed_first import most_informed_first
from masat.initializers.odometry import odometry
from masat.initializers.spanning_tree import spanning_tree
from masat.initializers.spectral import spectral
from masat.initializers.toro import toro


class Initializer(Protocol):
    """Gives a graph its poses; the first line of its docstring describes it to users."""

    def __call__(self, graph: PoseGraph, root: int | None = None) -> PoseGraph:
        """Return the graph with poses, the root at the identity."""


INITIALIZERS: dict[str, Initializer] = {
    "auto": auto,
    "odometry": odometry,
    "spanning_tree": spanning_tree,
    "masat": masat,
    "most_informed_first": most_informed_first,
    "lago": lago,
    "chordal": chordal,
    "spectral": spectral,
    "toro": toro,
    "cauchy": cauchy,
    "lifted": lifted,
    "given": given,
}


def initialize(graph: PoseGraph, method: str = "masat", *, root: int | None = None) -> PoseGraph:
    """Give a graph an initial guess.

    Parameters
    ----------
    graph : PoseGraph
        The graph. Its own poses count only for fixed nodes, and for the method "given".
    method : str
        One of `masat.initializers.INITIALIZERS`.
    root : int, optional
        Id of the node placed at the identity. Default: the smallest of its component. Each further
        component has a root of its own, its smallest id; components with fixed nodes begin there.

    Returns
    -------
    PoseGraph
        The graph with poses, (n, 3) or (n, 7) in the order of `ids`. Its `notes` tell what was
        bridged or left open; each new one is also a `MasatWarning`.

    Raises
    ------
    InitializationError
        If the method is unknown or cannot do what is asked.
    GraphError
        If the root is not in the graph.
    """
    if method not in INITIALIZERS:
        raise InitializationError(
            f"unknown initial guess {method!r}; known: {', '.join(INITIALIZERS)}"
        )
    guess = INITIALIZERS[method](graph, root)
    for note in guess.notes:
        if note not in graph.notes:
            warnings.warn(note, MasatWarning, stacklevel=2)
    return guess
