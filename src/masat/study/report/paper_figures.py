"""The paper's figures 1 to 6, drawn again from the seeds of the stored runs."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from masat.files import write_atomically
from masat.graph import PoseGraph
from masat.plotting import plot
from masat.study.names import Case, Sigma
from masat.study.report.cells import Cell
from masat.study.report.document import Figure
from masat.study.report.glossary import spoken
from masat.study.report.paper import Published
from masat.study.trial import initial_guess, instance, solve
from masat.study.worlds import GROUND_TRUTH

_TREE, _MASAT = "spanning_tree", "masat"
_INITS = ("odometry", _TREE, _MASAT, GROUND_TRUTH)


def paper_figures(
    cells: list[Cell], inits: tuple[str, ...], paper: Published, folder: Path, max_iterations: int
) -> list[Figure]:
    """Draw those of the paper's figures whose worlds, noise levels and initial guesses there are.

    Parameters
    ----------
    cells : list of Cell
        The trials of the study.
    inits : tuple of str
        The initial guesses of the study; without all four of the paper there is no figure.
    paper : Published
        Empty if the study cannot be compared with the paper; then there is no figure either.
    folder : Path
        Where the pictures are written.
    max_iterations : int
        Limit of the Gauss-Newton iterations.
    """
    found = {(c.world, c.sigma): c for c in cells if (c.world, c.sigma) in paper.rates}
    if not found or not set(_INITS) <= set(inits):
        return []
    drawer = _Drawer(folder, max_iterations)
    drawer.draw_solutions(
        1, found.get(("Manhattan3500", _same(0.2))), (_TREE, _MASAT, GROUND_TRUTH)
    )
    drawer.draw_bad_guess(2, found.get(("City10k", _same(0.3))))
    if any(world == "Manhattan10000" for world, _ in found):
        drawer.draw_guesses(3, Case("Manhattan10000", (0.0, 0.0, 0.1), 0))
    drawer.draw_solutions(4, found.get(("Manhattan10000", _same(0.2))), _INITS)
    drawer.draw_solutions(5, found.get(("Manhattan3500", _same(0.2))), _INITS)
    levels = [_same(sigma) for sigma in (0.1, 0.2, 0.35)]
    if all(("City10k", level) in found for level in levels):
        drawer.draw_levels(6, "City10k", levels)
    return drawer.figures


class _Drawer:
    def __init__(self, folder: Path, max_iterations: int) -> None:
        self._folder = folder
        self._limit = max_iterations
        self.figures: list[Figure] = []

    def draw_solutions(self, number: int, cell: Cell | None, inits: tuple[str, ...]) -> None:
        """Draw what Gauss-Newton makes of initial guesses of a telling instance."""
        if cell is None:
            return
        case = _telling_instance(cell, fails=_TREE, succeeds=_MASAT)
        listed = ", ".join(map(spoken, inits[:-1])) + f" and {spoken(inits[-1])}"
        self._add(
            number,
            self._solutions(case, inits),
            f"After at most {self._limit} iterations of Gauss-Newton from {listed}: {case.name}. "
            f"{_EXPLAINED}",
        )

    def draw_bad_guess(self, number: int, cell: Cell | None) -> None:
        """Draw the spanning tree of a telling instance, its solution, and the truth."""
        if cell is None:
            return
        case = _telling_instance(cell, fails=_TREE, succeeds=_MASAT)
        graph = instance(case)
        guess = initial_guess(graph, _TREE)
        panels = {
            "spanning tree": guess,
            "after Gauss-Newton": solve(guess, self._limit).graph,
            "ground truth": graph,
        }
        caption = f"A bad initial guess, its Gauss-Newton solution, and the truth: {case.name}."
        self._add(number, panels, caption)

    def draw_guesses(self, number: int, case: Case) -> None:
        """Draw the paper's initial guesses of a case, not optimized."""
        graph = instance(case)
        self._add(
            number,
            {spoken(init): initial_guess(graph, init) for init in _INITS},
            f"The initial guesses beside the truth, with noise of theta alone: {case.name}. A "
            "sigma of 0 leaves x and y exact.",
        )

    def draw_levels(self, number: int, world: str, levels: Iterable[Sigma]) -> None:
        """Draw the solutions of the first instance at several noise levels."""
        panels: dict[str, PoseGraph] = {}
        for level in levels:
            panels |= self._solutions(Case(world, level, 0), _INITS, f"{level[0]:g}: ")
        self._add(
            number,
            panels,
            f"{world} after Gauss-Newton from each initial guess; before the colon the sigma of "
            f"x, y (meters) and theta (radians). {_EXPLAINED}",
        )

    def _solutions(
        self, case: Case, inits: tuple[str, ...], prefix: str = ""
    ) -> dict[str, PoseGraph]:
        graph = instance(case)
        results = {init: solve(initial_guess(graph, init), self._limit) for init in inits}
        return {
            f"{prefix}{spoken(init)}, reduced chi2 {r.reduced_chi2:.3g}": r.graph
            for init, r in results.items()
        }

    def _add(self, number: int, panels: dict[str, PoseGraph], caption: str) -> None:
        path = self._folder / f"figure{number}.png"
        columns = 4 if len(panels) % 4 == 0 else 3
        picture = plot(panels, path, columns=columns, dpi=80 if columns < 4 else 60)
        write_atomically(path.with_suffix(".pdf"), picture.encode("pdf"))
        self.figures.append(Figure(path, f"Figure {number} of the paper. {caption}"))


_EXPLAINED = "Reduced chi2 is chi2 divided by the degrees of freedom."


def _same(sigma: float) -> Sigma:
    return (sigma, sigma, sigma)


def _telling_instance(cell: Cell, *, fails: str, succeeds: str) -> Case:
    """Return the first instance that only one of two initial guesses solves, or else the first."""
    for k in sorted(cell.trials[succeeds]):
        other = cell.trials[fails].get(k)
        if (
            other is not None
            and other.success() is None
            and cell.trials[succeeds][k].success() is not None
        ):
            return Case(cell.world, cell.sigma, k)
    return Case(cell.world, cell.sigma, 0)
