"""Sessions that are merged: the map, and the time it takes, against those of the uncut graph.

Run `python -m benchmarks.sessions [GRAPH ...] [--seeds N]`; needs the public graphs (MASAT_DATA).
Each graph is cut into sessions of consecutive nodes, with ids from zero and a random frame each.
The links are the edges that were cut. A star marks what misses the figure that is wanted.
"""

from __future__ import annotations

import argparse
import statistics
import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from time import perf_counter
from typing import NamedTuple

import numpy as np

import masat
from benchmarks.graphs import CASES, quietly_read, unused
from benchmarks.threads import single_threaded
from masat import PoseGraph, lie
from masat.arrays import Flags, Floats, Ids
from masat.worlds import add_false_closures, normalized

GRAPHS = ("M3500", "city10000", "sphere2500")
COUNTS = (4, 8)
KINDS = ("random", "grouped", "alias")
FRACTION = 0.3
# What is wanted: chi2 relative to that of the uncut graph, and the ratio of times.
MAX_GAP, MAX_RATIO = 1e-9, 1.3
# What is wanted of a map with false links: chi2 of the true edges there, over the lowest.
MAX_EXCESS = 1e-3
_ROUNDS = 7


class Cut(NamedTuple):
    """A graph cut into sessions.

    Attributes
    ----------
    parts : list of PoseGraph
        The sessions, with ids from zero and a frame of their own each.
    links : tuple
        What `masat.merge` takes: ends (session, id, session, id), measurements and information.
    is_link : ndarray of bool, (m,)
        Which edges of the graph are links.
    """

    parts: list[PoseGraph]
    links: tuple[Ids, Floats, Floats]
    is_link: Flags


def cut(graph: PoseGraph, count: int, seed: int = 0) -> Cut:
    """Cut a graph into as many sessions of consecutive nodes."""
    random = np.random.default_rng(seed)
    n = len(graph)
    session = np.arange(n) * count // n
    first = np.searchsorted(session, np.arange(count))
    ends = session[graph.edge_indices]
    links = ends[:, 0] != ends[:, 1]
    parts = []
    for k in range(count):
        part = graph.without_nodes(graph.ids[session != k])
        part = part.relabel({int(node): i for i, node in enumerate(part.ids)})
        frame = lie.retract(lie.identity(graph.dimension), random.normal(size=graph.dof))
        assert part.poses is not None
        part = part.with_poses(lie.compose(frame, part.poses))
        parts.append(replace(part, notes=()))
    rows = np.empty((int(links.sum()), 4), np.int64)
    rows[:, 0::2] = ends[links]
    rows[:, 1::2] = graph.edge_indices[links] - first[ends[links]]
    return Cut(parts, (rows, graph.measurements[links], graph.information[links]), links)


def spoiled(graph: PoseGraph, pieces: Cut, kind: str, seed: int) -> Cut:
    """Return the cut with false links in addition, so many that they are 30 % of all links."""
    random = np.random.default_rng([seed, 3])
    count = len(pieces.parts)
    session = np.arange(len(graph)) * count // len(graph)
    first = np.searchsorted(session, np.arange(count))
    true = len(pieces.links[0])
    wanted = round(FRACTION / (1 - FRACTION) * true)
    # False links are the false loop closures between sessions of a graph that has enough of them.
    many, is_false = add_false_closures(graph, kind, 0.6, seed=seed)
    ends = many.edge_indices[is_false]
    of = session[ends]
    chosen = np.flatnonzero(of[:, 0] != of[:, 1])
    if kind == "random":
        chosen = random.permutation(chosen)
    chosen = chosen[:wanted]
    assert len(chosen) == wanted
    edges = np.flatnonzero(is_false)[chosen]
    rows = np.empty((wanted, 4), np.int64)
    rows[:, 0::2], rows[:, 1::2] = of[chosen], ends[chosen] - first[of[chosen]]
    false = (rows, many.measurements[edges], many.information[edges])
    together = [np.concatenate(both) for both in zip(pieces.links, false, strict=True)]
    return pieces._replace(links=(together[0], together[1], together[2]))


def solved(graph: PoseGraph) -> masat.Result:
    """Return the map of a graph, without warnings."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", masat.MasatWarning)
        return masat.solve(graph)


def interleaved(tasks: dict[str, Callable[[], object]]) -> dict[str, float]:
    """Return the median time of each task in ms."""
    times: dict[str, list[float]] = {name: [] for name in tasks}
    for _ in range(_ROUNDS):
        for name, task in tasks.items():
            begin = perf_counter()
            task()
            times[name].append(1e3 * (perf_counter() - begin))
    return {name: statistics.median(values) for name, values in times.items()}


def merged_table(names: list[str]) -> None:
    """Print how the map of merged sessions compares with that of the uncut graph."""
    print("merged sessions against the uncut graph: chi2 within 1e-9, time at most 1.3 times")
    print(
        f"{'':<12}{'sessions':>9}{'links':>7}{'chi2':>16}{'gap':>10}{'uncut ms':>10}"
        f"{'merged ms':>11}{'ratio':>8}"
    )
    for name in names:
        graph = quietly_read(CASES[name].source)
        best = solved(graph).chi2
        for count in COUNTS:
            pieces = cut(graph, count)
            merged = _merged(pieces)
            gap = abs(merged.chi2 / best - 1)
            times = interleaved(
                {
                    "uncut": partial(_uncut, graph),
                    "merged": partial(_merged, pieces),
                }
            )
            ratio = times["merged"] / times["uncut"]
            print(
                f"{name:<12}{count:>9}{len(pieces.links[0]):>7}{merged.chi2:>16.9g}"
                f"{starred(f'{gap:.1e}', gap > MAX_GAP, 10)}{times['uncut']:>10.1f}"
                f"{times['merged']:>11.1f}{starred(f'{ratio:.2f}', ratio > MAX_RATIO, 8)}",
                flush=True,
            )


def _uncut(graph: PoseGraph) -> masat.Result:
    return solved(unused(graph))


def _merged(pieces: Cut) -> masat.Result:
    return solved(masat.merge(pieces.parts, pieces.links))


def false_table(names: list[str], seeds: int) -> None:
    """Print what a robust solve makes of false links."""
    print()
    print(
        "with 30 % false links and robust=True: chi2 of the true edges over their lowest, minus 1"
    )
    print(
        f"{'':<12}{'sessions':>9}{'kind':>9}{'seed':>6}{'true':>6}{'false':>7}{'kept: true':>12}"
        f"{'false':>7}{'excess':>10}{'s':>8}{'units':>8}"
    )
    for name in names:
        plain = solved(quietly_read(CASES[name].source))
        graph = normalized(plain.graph)
        begin = perf_counter()
        best = solved(unused(graph)).chi2
        unit = perf_counter() - begin
        for count in COUNTS:
            for kind in KINDS:
                for seed in range(seeds):
                    print(_false(name, graph, best, unit, count, kind, seed), flush=True)


def _false(
    name: str, graph: PoseGraph, best: float, unit: float, count: int, kind: str, seed: int
) -> str:
    pieces = cut(graph, count, seed)
    bad = spoiled(graph, pieces, kind, seed)
    merged = masat.merge(bad.parts, bad.links)
    begin = perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", masat.MasatWarning)
        result = masat.solve(merged, robust=True)
    seconds = perf_counter() - begin
    assert result.kept is not None
    true, false = len(pieces.links[0]), len(bad.links[0]) - len(pieces.links[0])
    kept = result.kept[-true - false :]
    clean = masat.merge(pieces.parts, pieces.links).with_poses(result.poses)
    if not kept[true:].any():
        clean = masat.optimize(clean).graph
    excess = clean.chi2 / best - 1
    return (
        f"{name:<12}{count:>9}{kind:>9}{seed:>6}{true:>6}{false:>7}{int(kept[:true].sum()):>12}"
        f"{starred(str(int(kept[true:].sum())), bool(kept[true:].any()), 7)}"
        f"{starred(f'{excess:.1e}', excess > MAX_EXCESS, 10)}{seconds:>8.2f}{seconds / unit:>8.1f}"
    )


def starred(text: str, fails: bool, width: int) -> str:
    """Return a cell, with a star if it misses what is wanted."""
    return f"{text}{'*' if fails else ' '}".rjust(width)


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("graphs", nargs="*", metavar="GRAPH")
    parser.add_argument("--seeds", type=int, default=1)
    arguments = parser.parse_args()
    names = [name for name in GRAPHS if not arguments.graphs or name in arguments.graphs]
    merged_table(names)
    false_table(names, arguments.seeds)


if __name__ == "__main__":
    single_threaded()
    main()
