"""Which loop closures a robust solve keeps, against the truth, and in what time.

Run `python -m benchmarks.robust [TEXT ...] [--seeds N]`; needs the public graphs (MASAT_DATA). Only
rows whose name contains one of the texts are measured, such as "labeled", "spoiled CSAIL",
"alias .5", "scales" or "harmless". All rows with 10 seeds take hours. A star marks what misses the
figure that is wanted.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Iterable
from functools import partial

import numpy as np

import masat
from benchmarks.data import DATA
from benchmarks.false_closures import labeled, labeled_names
from benchmarks.graphs import quietly_read
from benchmarks.spoiled import ROWS, Row, plainly_solved, spoiled_graphs, timed
from benchmarks.threads import single_threaded
from masat import PoseGraph
from masat.arrays import Flags
from masat.quantiles import FAR_GATE
from masat.residuals import chi2_per_edge
from masat.robust.closures import Closures
from masat.robust.objective import cost
from masat.study.closure_trial import unsolved
from masat.study.scores import Scores, score

LABELED_SECONDS, LABELED_RMSE, LABELED_RECALL = 1.0, 0.1, 0.98
# Sequences whose recall is wanted; the others have next to no true loop closures.
LABELED_SEQUENCES = ("kitti_00", "kitti_05")
# In plain solves of the clean graph, by the largest fraction of false loop closures.
MAX_UNITS = {0.5: 20.0, 0.9: 50.0}
HARMLESS_UNITS = 3.0


def starred(text: str, fails: bool, width: int) -> str:
    """Return a cell, with a star if it misses what is wanted."""
    return f"{text}{'*' if fails else ' '}".rjust(width)


def labeled_table(names: Iterable[str]) -> None:
    """Print the table of the labeled graphs of KITTI."""
    print(
        "labeled KITTI: no false loop closure kept, recall at least .98 on 00 and 05, at most .1 m"
    )
    print(
        "from the map of the true ones, the objective at most the truth's, under 1 s; 'units' are"
    )
    print("plain solves of the true edges")
    print(
        f"{'':<32}{'true':>7}{'false':>7}{'kept:':>7}{'false':>7}{'recall':>8}{'rmse, m':>9}"
        f"{'above truth':>13}{'s':>8}{'units':>8}"
    )
    for name in names:
        print(_labeled(name, *labeled(name)), flush=True)


def _labeled(name: str, graph: PoseGraph, is_true: Flags) -> str:
    clean, plain_seconds = plainly_solved(graph.without_edges(~is_true))
    result, seconds = timed(partial(masat.solve, unsolved(graph), robust=True))
    assert result.kept is not None
    assert result.decision is not None
    found = score(clean.graph, graph, ~is_true, result.kept, result.poses)
    closures = Closures(graph)
    of_truth = cost(closures, is_true[closures.edges], chi2_per_edge(graph, clean.poses))
    above = result.decision.cost - of_truth
    wanted = name.startswith(LABELED_SEQUENCES)
    recall = 1.0 if found.recall is None else found.recall
    # The objective of rescaled information is another one.
    rescaled = result.decision.used != (1, 1)
    objective = "-" if rescaled else f"{above:.2g}"
    return (
        f"{name:<32}{found.true_closures:>7}{found.false_closures:>7}{found.true_kept:>7}"
        f"{starred(str(found.false_kept), found.false_kept > 0, 7)}"
        f"{starred(f'{recall:.3f}', wanted and recall < LABELED_RECALL, 8)}"
        f"{starred(f'{found.rmse:.3f}', found.rmse > LABELED_RMSE, 9)}"
        f"{starred(objective, not rescaled and above > 1e-3 * of_truth, 13)}"
        f"{starred(f'{seconds:.2f}', seconds > LABELED_SECONDS, 8)}{seconds / plain_seconds:>8.0f}"
    )


def spoiled_table(rows: Iterable[Row], seeds: int) -> None:
    """Print the table of the graphs with simulated false loop closures."""
    print(f"{seeds} seeds: successes, strict ones, recall and false loop closures kept, with the")
    print("least of the seeds and the most; median and largest time in plain solves of the clean")
    print("graph, wanted at most 20 up to a fraction of .5 and 50 above; median of the estimated")
    print("scale of the covariances")
    print(
        f"{'':<32}{'success':>9}{'strict':>8}{'recall':>9}{'least':>8}{'false':>8}{'most':>7}"
        f"{'units':>8}{'most':>7}{'s':>8}{'scale':>9}"
    )
    for row in rows:
        print(_spoiled(row, seeds), flush=True)


def _spoiled(row: Row, seeds: int) -> str:
    scores: list[Scores] = []
    seconds, units, scales = [], [], []
    for what in spoiled_graphs(row, seeds):
        result, took = timed(partial(masat.solve, what.graph, robust=True))
        assert result.kept is not None
        assert result.decision is not None
        # Judged with the right information, also where the solve was given another one.
        scores.append(score(what.clean, what.graph, what.is_false, result.kept, result.poses))
        seconds.append(took)
        units.append(took / what.plain_seconds)
        scales.append(result.decision.scales.closures or 1.0)
    successes, strict = sum(s.success for s in scores), sum(s.strict_success for s in scores)
    recalls = [s.recall or 0.0 for s in scores]
    false = [s.false_kept for s in scores]
    limit = MAX_UNITS[0.5] if row.fraction <= 0.5 else MAX_UNITS[0.9]
    return (
        f"{row.name:<32}{starred(f'{successes}/{seeds}', successes < row.success * seeds, 9)}"
        f"{starred(f'{strict}/{seeds}', strict < row.strict * seeds, 8)}"
        f"{starred(f'{np.mean(recalls):.3f}', bool(np.mean(recalls) < row.recall), 9)}"
        f"{min(recalls):>8.3f}{starred(str(sum(false)), row.only_true and sum(false) > 0, 8)}"
        f"{max(false):>7}{starred(f'{np.median(units):.1f}', bool(np.median(units) > limit), 8)}"
        f"{max(units):>7.0f}{np.median(seconds):>8.2f}{np.median(scales):>9.3g}"
    )


def harmless_table(files: Iterable[str]) -> None:
    """Print the table of the public graphs, whose loop closures all count as true."""
    print(
        "public graphs: what a robust solve rejects, and how many of that within the 1 - 1e-5 gate"
    )
    print("in the plain map, its information normalized there; distance of the two maps; time over")
    print(f"that of the plain solve, wanted at most {HARMLESS_UNITS:g}")
    print(
        f"{'':<46}{'nodes':>7}{'closures':>9}{'rejected':>9}{'within':>8}{'rmse, m':>10}"
        f"{'plain s':>9}{'units':>9}{'scale':>9}"
    )
    for file in files:
        print(_harmless(file), flush=True)


def _harmless(name: str) -> str:
    graph = quietly_read(DATA / name.removeprefix("harmless "))
    plain, plain_seconds = plainly_solved(graph)
    try:
        result, seconds = timed(partial(masat.solve, unsolved(graph), robust=True))
    except masat.MasatError as error:
        return f"{name:<46}{len(graph):>7}  {type(error).__name__}: {error}"
    assert result.kept is not None
    assert result.decision is not None
    nothing = np.zeros(len(graph.edges), np.bool_)
    found = score(plain.graph, graph, nothing, result.kept, result.poses)
    reduced = plain.reduced_chi2 or 1.0
    chi2 = plain.graph.chi2_per_edge[~result.kept] / reduced
    within = int((chi2 <= FAR_GATE[graph.dof]).sum())
    units = seconds / plain_seconds
    scale = result.decision.scales.closures or 1.0
    return (
        f"{name:<46}{len(graph):>7}{found.true_closures:>9}"
        f"{found.true_closures - found.true_kept:>9}{starred(str(within), within > 0, 8)}"
        f"{found.rmse:>10.3g}{plain_seconds:>9.3f}"
        f"{starred(f'{units:.1f}', units > HARMLESS_UNITS, 9)}{scale:>9.3g}"
    )


def harmless_names() -> list[str]:
    """Return the names of the rows of the public graphs."""
    files = sorted(path for folder in ("2d", "3d") for path in (DATA / folder).iterdir())
    return [f"harmless {path.relative_to(DATA).as_posix()}" for path in files]


def arguments(description: str) -> tuple[list[str], int]:
    """Return the texts that select rows, and the number of seeds."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("text", nargs="*", help="measure rows whose name contains one of these")
    parser.add_argument("--seeds", type=int, default=10)
    given = parser.parse_args()
    return given.text, given.seeds


def selected(names: Iterable[str], texts: list[str]) -> list[str]:
    """Return the names that contain one of the texts; all names if there are no texts."""
    return [name for name in names if not texts or any(text in name for text in texts)]


def main() -> None:
    """Print the tables."""
    single_threaded()
    warnings.simplefilter("ignore", masat.MasatWarning)
    texts, seeds = arguments("Which loop closures a robust solve keeps.")
    if names := selected((f"labeled {name}" for name in labeled_names()), texts):
        labeled_table(name.removeprefix("labeled ") for name in names)
    if names := selected(ROWS, texts):
        spoiled_table((ROWS[name] for name in names), seeds)
    if names := selected(harmless_names(), texts):
        harmless_table(names)


if __name__ == "__main__":
    main()
