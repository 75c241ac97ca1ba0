"""What the names and abbreviations of a report mean."""

from __future__ import annotations

import re
from collections.abc import Iterable

from masat.study.report.document import Block, Heading, Paragraph, Table
from masat.study.worlds import GROUND_TRUTH

MEANINGS = {
    "masat": "MASAT, Multi-Ancestor Spatial Approximation Tree: breadth-first, each node at the "
    "average of what its placed neighbors say",
    "odometry": "initial guess along the chain of consecutive ids",
    "spanning_tree": "initial guess along a breadth-first spanning tree",
    "most_informed_first": "as masat, but the best determined node is placed first",
    "lago": "LAGO, Linear Approximation for Graph Optimization (2D)",
    "chordal": "rotations by linear least squares on matrices, then translations",
    "spectral": "rotations by eigenvectors of the connection Laplacian, then translations",
    "toro": "TORO, Tree-based netwORk Optimizer: stochastic gradient descent on a tree",
    "cauchy": "the loss of Cauchy",
    "lifted": "optimization in a higher rank, rounded to poses",
    "auto": "the initial guess that masat.solve chooses by itself",
    GROUND_TRUTH: "the true poses, a control that shows what any initial guess can reach",
    "robust": "the decision on loop closures of masat.solve(graph, robust=True)",
    "plain": "all edges are believed",
    "geman_mcclure": "the loss of Geman and McClure",
    "geman_mcclure_refit": "the loss of Geman and McClure, then least squares of what it kept",
    "huber": "the loss of Huber",
    "tukey": "the biweight of Tukey",
    "dcs": "DCS, Dynamic Covariance Scaling",
    "gnc_tls": "GNC-TLS, Graduated Non-Convexity with Truncated Least Squares",
    "random": "false loop closures between random pairs of nodes",
    "local": "false loop closures between nodes at most 20 apart",
    "grouped": "runs of 20 false loop closures with the same measurement",
    "alias": "runs of 20 false loop closures that agree with each other",
}
"""What the names in tables mean."""

_ABBREVIATIONS = {
    "chi2": "sum of e' W e over the edges: residual e, information W",
    "p": "p-value: how likely a difference as large as this one is by chance alone",
    "ms": "milliseconds",
    "s": "seconds",
}
# As they are spelled in figures.
_SPOKEN = {
    "masat": "MASAT",
    "lago": "LAGO",
    "toro": "TORO",
    "dcs": "DCS",
    "gnc_tls": "GNC-TLS",
    "geman_mcclure": "Geman-McClure",
    "geman_mcclure_refit": "Geman-McClure, refit",
    "cauchy": "Cauchy",
    "huber": "Huber",
    "tukey": "Tukey",
}


def spoken(name: str) -> str:
    """Return the name of an initial guess or a method as figures spell it."""
    return _SPOKEN.get(name, name.replace("_", " "))


def spoken_world(name: str) -> str:
    """Return "manhattan, 1,000 nodes, 1,550 edges" for "manhattan:1000:1550"."""
    kind, *sizes = name.split(":")
    if not all(size.isdecimal() for size in sizes):
        return name
    counts = [
        f"{int(size):,} {noun}" for size, noun in zip(sizes, ("nodes", "edges"), strict=False)
    ]
    return ", ".join([kind, *counts])


def glossary(columns: Iterable[str], blocks: list[Block]) -> list[Block]:
    """Return a table of the names and abbreviations that a report uses.

    Parameters
    ----------
    columns : iterable of str
        What is compared: initial guesses or methods.
    blocks : list of Block
        The report. What is a whole cell of a table counts, such as the kind of false loop closures.
    """
    names, texts = set(columns), []
    for block in blocks:
        match block:
            case Heading(text) | Paragraph(text):
                texts.append(text)
            case Table(_, titles, body):
                cells = [*titles, *(cell for row in body for cell in row)]
                names.update(cells)
                texts += cells
    everything = "\n".join(texts)
    rows = tuple(
        (name, meaning)
        for name, meaning in (*MEANINGS.items(), *_ABBREVIATIONS.items())
        if name in names
        or (name in _ABBREVIATIONS and re.search(rf"(?<![\w']){name}(?!\w)", everything))
    )
    if not rows:
        return []
    return [Heading("Abbreviations"), Table("abbreviations", ("name", "meaning"), rows)]
