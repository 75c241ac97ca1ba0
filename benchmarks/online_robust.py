"""Maps that grow and judge their loop closures, on graphs with false ones in temporal order.

    python -m benchmarks.online_robust [GRAPH ..] [--kinds KIND ..] [--fraction F] [--seeds N]

For each graph and kind of false loop closures: success of the final map as `benchmarks.robust`
measures it, that of the batch decision, and the time of all steps over that of a plain map of the
true edges. Times are those of the process, reviews included, on one thread of arithmetic.
"""

from __future__ import annotations

import argparse
import warnings
from statistics import median
from time import process_time

import numpy as np

import masat
from benchmarks.spoiled import Row, spoiled_graphs
from benchmarks.threads import single_threaded
from masat.online.stream import Replay, replay
from masat.study.closure_trial import Spoiled, unsolved
from masat.study.scores import Scores, score

GRAPHS = ("M3500", "CSAIL", "intel", "sphere2500")
KINDS = ("random", "alias")


def timed(graph: masat.PoseGraph, *, robust: bool) -> tuple[Replay, float]:
    """Return a map that has grown, and the seconds that all of it took."""
    begin = process_time()
    run = replay(graph, robust=robust)
    run.map._end_review()
    return run, process_time() - begin


def scored(case: Spoiled, run: Replay) -> Scores:
    """Return how good the map of a run is."""
    kept = ~np.isin(run.numbers, run.map.rejected)
    poses = run.map.poses[np.argsort(run.map.ids)]
    return score(case.clean, case.graph, case.is_false, kept, poses)


def main() -> None:
    """Print a row for each graph and kind."""
    parser = argparse.ArgumentParser(description=__doc__, allow_abbrev=False)
    parser.add_argument("graphs", nargs="*", default=GRAPHS)
    parser.add_argument("--kinds", nargs="+", default=KINDS)
    parser.add_argument("--fraction", type=float, default=0.5)
    parser.add_argument("--seeds", type=int, default=10)
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    single_threaded()
    print(
        f"{'':<22}{'success:':>9}{'steps':>7}{'+ end':>7}{'batch':>7}{'false':>7}{'recall':>8}"
        f"{'plain s':>9}{'times':>7}{'slowest':>9}{'end s':>8}"
    )
    for name in options.graphs:
        for kind in options.kinds:
            print(_row(name, kind, options.fraction, options.seeds), flush=True)


def _row(name: str, kind: str, fraction: float, seeds: int) -> str:
    after, final, batch, false, recall = [], [], [], 0, []
    plain_seconds, times, slowest, end = [], [], [], []
    for case in spoiled_graphs(Row(name, kind, fraction), seeds):
        _, plain = timed(unsolved(case.clean), robust=False)
        run, robust = timed(case.graph, robust=True)
        found = scored(case, run)
        after.append(found.success)
        begin = process_time()
        run.map.optimize()
        end.append(process_time() - begin)
        found = scored(case, run)
        final.append(found.success)
        false += found.false_kept
        recall.append(1.0 if found.recall is None else found.recall)
        whole = masat.solve(case.graph, robust=True, threads=1)
        assert whole.kept is not None
        batch.append(score(case.clean, case.graph, case.is_false, whole.kept, whole.poses).success)
        plain_seconds.append(plain)
        times.append(robust / plain)
        slowest.append(1e3 * float(run.seconds.max()))
    return (
        f"{name + ' ' + kind:<22}{sum(after):>16}{sum(final):>7}{sum(batch):>7}{false:>7}"
        f"{np.mean(recall):>8.3f}{median(plain_seconds):>9.2f}{median(times):>7.1f}"
        f"{median(slowest):>9.0f}{median(end):>8.2f}"
    )


if __name__ == "__main__":
    main()
