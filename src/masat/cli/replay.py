"""`masat replay`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from masat.arrays import AnyArray, Floats, Ids
from masat.cli import options, show
from masat.cli.progress import Steps
from masat.formats import format_of, write
from masat.graph import PoseGraph
from masat.online.growing import TOLERANCE, OnlineMap

if TYPE_CHECKING:
    from masat.online.stream import Replay

_MAX_FRAMES = 150
# chi2 of an edge below which measurements have no noise: nothing is to be compared then.
_NO_NOISE = 1e-12


@click.command(epilog="Example:  masat replay M3500.g2o --film growing.gif")
@options.graph_file
@click.option(
    "-o", "--output", "out", type=click.Path(path_type=Path), help="Map: .g2o, .tum or .kitti."
)
@click.option(
    "--film", type=click.Path(path_type=Path), help="Film of the map: .gif, or .mp4 with ffmpeg."
)
@click.option(
    "--step-budget",
    type=click.FloatRange(min=0, min_open=True),
    help="Seconds of each step after which nothing more is linearized again.  [default: no limit]",
)
@click.option(
    "--tolerance",
    type=click.FloatRange(0, 1, max_open=True),
    default=TOLERANCE,
    show_default=True,
    help="Fraction of chi2 by which a map may exceed its optimum.",
)
@click.option(
    "--robust",
    is_flag=True,
    help="Judge each loop closure when it arrives, and leave out those that seem false.",
)
@options.output
def replay(
    file: Path,
    file_format: str | None,
    indefinite: str,
    out: Path | None,
    film: Path | None,
    step_budget: float | None,
    tolerance: float,
    robust: bool,
    as_json: bool,
    quiet: bool,
) -> None:
    """Feed the graph in FILE to a map that grows, pose by pose, and say how long the steps take.

    Poses arrive in the order of their ids, each with its edges to earlier ones, its priors and what
    it saw of landmarks, as a front end would add them. After each step all poses are read. At the
    end the map is compared with the optimum of all measurements.
    """
    from masat.online.stream import replay as replayed

    options.check_outputs(file, out, film)
    if out is not None:
        format_of(out)
    if film is not None:
        from masat.plotting.film import check_film

        check_film(film)
    graph = options.load(file, file_format, indefinite, quiet)
    every = max(1, len(graph) // _MAX_FRAMES)
    frames: list[tuple[Floats, Ids]] = []
    position = graph.edge_indices.astype(np.int64)
    newest = position.max(axis=1, initial=0)
    with Steps(file.name, len(graph), quiet=quiet) as line:

        def report(done: int, online: OnlineMap) -> None:
            line.advance(done)
            if film is not None and (done % every == 0 or done == len(graph)):
                frames.append((online.poses, position[newest < done]))

        run = replayed(graph, tolerance=tolerance, robust=robust, budget=step_budget, report=report)
    chi2, rejected = run.map.chi2, run.map.rejected
    start = perf_counter()
    optimum = run.map.optimize()
    batch_seconds = perf_counter() - start
    if out is not None:
        edges, closures = _judged(run)
        left_out = np.zeros(len(graph.edges), np.bool_)
        left_out[edges[~closures["kept"]]] = True
        write(_with_map(graph.without_edges(left_out), optimum.graph), out)
    if film is not None:
        from masat.plotting.film import write_film

        write_film(frames, film)
    excess, compared = None, "; the map was there up to rounding"
    if not np.array_equal(run.map.rejected, rejected):
        compared = ""  # Other edges have another optimum.
    elif optimum.chi2 > _NO_NOISE * len(graph.edges):
        excess = chi2 / optimum.chi2 - 1
        compared = f"; the map was {excess:.1e} above it"
    milliseconds = 1e3 * run.seconds
    if as_json:
        show.as_json(
            {
                "file": str(file),
                "steps": len(graph),
                "seconds": float(run.seconds.sum()),
                "median_ms": float(np.median(milliseconds)),
                "p99_ms": float(np.percentile(milliseconds, 99)),
                "max_ms": float(milliseconds.max()),
                "chi2": chi2,
                "optimum": optimum.chi2,
                "excess": excess,
                "optimize_seconds": batch_seconds,
                **({"rejected": _rejected(run)} if robust else {}),
            }
        )
    elif not quiet:
        written = [str(path) for path in (out, film) if path is not None]
        show.rows(
            [
                ("steps", f"{len(graph)}, with {_contents(graph)}"),
                ("time", show.duration(float(run.seconds.sum()))),
                (
                    "a step",
                    f"median {np.median(milliseconds):.3g} ms, 99 % within "
                    f"{np.percentile(milliseconds, 99):.3g} ms, the slowest "
                    f"{milliseconds.max():.3g} ms",
                ),
                *_row_of_closures(run, len(rejected)),
                *_row_of_waiting(run),
                ("chi2", f"{chi2:.6g} after the last step"),
                (
                    "optimum",
                    f"{optimum.chi2:.6g}, reached in {show.duration(batch_seconds)}{compared}",
                ),
                ("written", ", ".join(written) or "nothing: name a file with -o"),
            ]
        )


def _contents(graph: PoseGraph) -> str:
    """Return how many edges, priors and observations a graph has."""
    parts = [_counted(len(graph.edges), "edge")]
    if graph.priors is not None:
        parts.append(_counted(len(graph.priors), "prior"))
    if graph.landmarks is not None:
        observations = _counted(len(graph.landmarks.observations), "observation")
        parts.append(f"{observations} of {_counted(len(graph.landmarks), 'landmark')}")
    return ", ".join(parts)


def _counted(count: int, noun: str) -> str:
    return f"{count} {noun}{'' if count == 1 else 's'}"


def _with_map(graph: PoseGraph, found: PoseGraph) -> PoseGraph:
    """Return a graph with the poses of a map, and those landmarks that the map has placed."""
    assert found.poses is not None
    out = graph.with_poses(found.poses[found.index(graph.ids)])
    seen = graph.landmarks
    if seen is None:
        return out
    if graph.priors is not None:
        known = np.isin(graph.priors.ids, np.concatenate([graph.ids, found.point_ids]))
        out = out.with_priors(graph.priors.rows(known))
    rows = np.isin(seen.observations[:, 1], found.point_ids)
    placed = replace(seen.observed(rows), ids=found.point_ids, positions=found.points)
    return out.with_landmarks(placed if len(placed) else None)


def _judged(run: Replay) -> tuple[Ids, AnyArray]:
    """Return the edges of the graph that were judged, and what is thought of them."""
    table = run.map.closures
    order = np.argsort(run.numbers)
    return order[np.searchsorted(run.numbers[order], table["edge"])], table


def _rejected(run: Replay) -> list[dict[str, Any]]:
    """Return what JSON says of the closures that are left out."""
    return [
        {
            "edge": int(edge),
            "from": int(row["from"]),
            "to": int(row["to"]),
            "reason": str(row["reason"]),
        }
        for edge, row in zip(*_judged(run), strict=True)
        if not row["kept"]
    ]


def _row_of_closures(run: Replay, before: int) -> list[tuple[str, str]]:
    if not run.map.robust:
        return []
    last = len(run.map.rejected)
    said = f"{len(run.map.closures)}, of which {before} were left out after the last step"
    if last != before:
        said += f" and {last} are after a decision on all together"
    return [("closures", said)]


def _row_of_waiting(run: Replay) -> list[tuple[str, str]]:
    waiting = [
        _counted(len(numbers), noun)
        for numbers, noun in (
            (run.map.waiting_priors, "prior"),
            (run.map.waiting_observations, "observation"),
        )
        if len(numbers)
    ]
    if not waiting:
        return []
    count = len(run.map.waiting_priors) + len(run.map.waiting_observations)
    rest = "that does not determine yet where what it measures lies"
    if count > 1:
        rest = "that do not determine yet where what they measure lies"
    return [("waiting", f"{' and '.join(waiting)} {rest}: no part of the map")]
