"""The public face of the explorer: `view` and what it returns."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from html import escape
from pathlib import Path

from numpy.typing import ArrayLike

from masat.files import write_atomically
from masat.graph import PoseGraph
from masat.optimizers import Result

_HEIGHT = 560  # pixels: with it the page and the cell that made it fit on a laptop's screen


def inline_page(html: str, height: int = _HEIGHT) -> str:
    """Return an element that shows a whole page inside another one, such as a notebook."""
    return (
        f'<iframe srcdoc="{escape(html)}" style="width: 100%; height: {height}px; border: 0" '
        "allowfullscreen></iframe>"
    )


class View:
    """An interactive view of a map: one HTML page that needs no server and no network.

    Jupyter displays it.

    Attributes
    ----------
    html : str
        The page.
    """

    def __init__(self, html: str) -> None:
        self.html = html

    def __repr__(self) -> str:
        return f"View({len(self.html) / 1e6:.2g} MB of HTML; write it with save(path))"

    def _repr_html_(self) -> str:
        return inline_page(self.html)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the page to a file, whole or not at all."""
        write_atomically(Path(path), self.html.encode())


def view(
    shown: PoseGraph | Result,
    path: str | os.PathLike[str] | None = None,
    *,
    before: PoseGraph | Mapping[str, PoseGraph] | None = None,
    iterations: Iterable[ArrayLike] = (),
    truth: PoseGraph | None = None,
    covariances: bool = False,
    title: str | None = None,
) -> View:
    """Make an interactive view of a map, an HTML page that any browser opens without a network.

    In it, nodes and edges can be pointed at and picked, colored by chi2, time, session or robust
    weight, searched by id, and switched off. The page explains its keys; docs/view.md explains the
    rest.

    Parameters
    ----------
    shown : PoseGraph or Result
        A graph with poses, or a result. That of a robust solve shows which loop closures were
        rejected, and why.
    path : path-like, optional
        File for the page. Without it the page is only returned.
    before : PoseGraph, or mapping of title to PoseGraph, optional
        The graph that was solved, or several earlier maps of the same nodes, which the slider goes
        through. If the poses of one are missing or placeholders, its odometry is drawn. After a
        robust solve, the graph that was solved also tells what the rejected loop closures measured.
    iterations : iterable of array_like, (n, 3) or (n, 7), optional
        Poses at the iterations, as `report_poses` of `masat.solve` gets them. In a large graph some
        of them are left out.
    truth : PoseGraph, optional
        The true poses, matched by stamp or id and moved onto the map as for the ATE.
    covariances : bool
        Whether to compute the covariances of all positions and to draw their ellipses.
    title : str, optional
        Title of the page. Default: "masat".

    Returns
    -------
    View
        The page: `html`, `save(path)`; Jupyter displays it.

    Raises
    ------
    GraphError
        If the graph has no poses, or if earlier maps have other nodes.
    EvaluationError
        If no pose of the map belongs to one of the truth.
    OptimizationError
        If covariances are wanted that the edges do not determine.

    Examples
    --------
    >>> import masat
    >>> from masat.worlds import manhattan, perturb
    >>> graph = perturb(manhattan(200, 400, extent=10, seed=0), (0.1, 0.1, 0.05), seed=0)
    >>> steps = []
    >>> result = masat.solve(graph, init="odometry", report_poses=steps.append)
    >>> page = masat.view(result, before=graph, iterations=steps)
    >>> page.save("map.html")  # doctest: +SKIP
    """
    # Presentation, which most programs do not need.
    from masat.viewing.page import page
    from masat.viewing.payload import pack
    from masat.viewing.scene import scene_of

    if isinstance(before, PoseGraph):
        before = {"before": before}
    header, arrays = scene_of(
        shown,
        before=before or {},
        iterations=iterations,
        truth=truth,
        covariances=covariances,
        title=title or "masat",
    )
    made = View(page(pack(header, arrays), header["title"]))
    if path is not None:
        made.save(path)
    return made
