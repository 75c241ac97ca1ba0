"""Position fixes on public graphs: what they cost, from which offsets they work, and certificates.

    python -m benchmarks.fixes cost [GRAPH ..]
    python -m benchmarks.fixes offsets [GRAPH ..] [--trials N]
    python -m benchmarks.fixes certificates [FILE ..]
    python -m benchmarks.fixes robust [GRAPH ..] [--trials N]

Every 20th node gets a fix at the best map, which is moved by a random motion. Its standard
deviation is half a meter, or one percent of a map that is smaller than 50 m. Where the residuals of
the edges are below what their information promises, the fixes promise as much less.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import warnings
from functools import partial
from pathlib import Path
from time import perf_counter

import numpy as np

import masat
from benchmarks.data import DATA, medians
from benchmarks.graphs import quietly_read
from benchmarks.threads import single_threaded
from masat import lie
from masat.arrays import Floats

_SIGMA, _PART, _EVERY = 0.5, 0.01, 20
_BAD, _BAD_METERS = 0.3, 50.0
_GRAPHS = ("2d/input_M3500_g2o.g2o", "2d/kitti_00.g2o", "3d/sphere2500.g2o")
_SUFFIXES = (".g2o", ".g2o.gz", ".txt", ".txt.gz", ".graph")
# The reduced chi2 of graphs that hold the measurements of a solved map.
_NO_NOISE = 1e-6
# Relative differences of chi2 from one offset to another that count as none.
_SAME = 1e-9


def motion(seed: int, dimension: int) -> Floats:
    """Return a random motion of kilometers and any heading."""
    rng = np.random.default_rng(seed)
    if dimension == 2:
        return np.array([*rng.normal(size=2) * 1e4, rng.uniform(-np.pi, np.pi)])
    q = rng.normal(size=4)
    return np.array([*rng.normal(size=3) * 1e4, *q / np.linalg.norm(q)])


def with_fixes(alone: masat.Result, moved: Floats) -> masat.PoseGraph:
    """Return the graph of a result with fixes near its poses, which a motion has moved."""
    graph, poses = alone.graph, alone.poses
    d, nodes = graph.dimension, np.arange(0, len(graph), _EVERY)
    sigma = min(_SIGMA, _PART * float(np.ptp(poses[:, :d], axis=0).max()))
    fixes = np.tile(lie.identity(d), (len(nodes), 1))
    fixes[:, :d] = poses[nodes, :d]
    # The noise is moved with the map, so that all motions pose the same problem.
    fixes[:, :d] += np.random.default_rng(0).normal(scale=sigma, size=(len(nodes), d))
    where = lie.compose(moved, fixes)[:, :d]
    reduced = alone.reduced_chi2 or 1.0
    promised = sigma if reduced < _NO_NOISE else sigma / min(reduced, 1.0) ** 0.5
    return graph.with_fixed([]).with_priors(masat.gps(graph.ids[nodes], where, promised))


def cost(names: list[str]) -> None:
    """Print the time from the file to the map with fixes and without."""
    print("file to map, medians in ms; wanted ratio at most 1.2")
    print(f"{'graph':24}  without     with  ratio")
    with tempfile.TemporaryDirectory() as folder:
        for name in names:
            graph = quietly_read(DATA / name)
            alone = masat.solve(graph)
            plain, fixed = Path(folder) / "plain.g2o", Path(folder) / "fixed.g2o"
            # The same poses, so that both files have as many digits.
            masat.write(alone.graph, plain)
            masat.write(with_fixes(alone, motion(0, graph.dimension)), fixed)
            took = medians(
                {
                    "without": partial(_solved, plain),
                    "with": partial(_solved, fixed),
                }
            )
            a, b = took.values()
            print(f"{Path(name).name:24} {a:8.1f} {b:8.1f} {b / a:6.2f}", flush=True)


def _solved(file: Path) -> masat.Result:
    return masat.solve(masat.read(file), threads=1)


def offsets(names: list[str], trials: int) -> None:
    """Print how many offsets and headings lead to the same chi2."""
    print(f"solved from {trials} random offsets and headings: chi2 within 1e-9 of the lowest")
    print(f"{'graph':24}    same  worst difference            chi2")
    for name in names:
        graph = quietly_read(DATA / name)
        alone = masat.solve(graph)
        chi2 = np.array(
            [
                masat.solve(with_fixes(alone, motion(seed, graph.dimension))).chi2
                for seed in range(trials)
            ]
        )
        off = chi2 / chi2.min() - 1
        print(
            f"{Path(name).name:24} {np.count_nonzero(off <= _SAME):3d}/{trials:<4d}"
            f"{off.max():18.1e} {chi2.min():15.8g}",
            flush=True,
        )


def robust(names: list[str], trials: int) -> None:
    """Print what a robust solve makes of fixes of which 30 % are 50 m off."""
    print(
        "30 % of the fixes 50 m off: bad fixes kept, good ones and closures rejected in all trials;"
    )
    print("largest distance of a map from that of the good fixes alone; medians of the times")
    print(f"{'graph':24} trials   kept  rejected  closures   rmse, m       s   plain solves")
    for name in names:
        alone = masat.solve(quietly_read(DATA / name))
        d, rows = alone.graph.dimension, []
        for seed in range(trials):
            fixed = with_fixes(alone, motion(seed, d))
            rng = np.random.default_rng([seed, 1])
            priors, count = fixed.priors, round(_BAD * len(fixed.priors or ()))
            assert priors is not None
            bad = np.zeros(len(priors), np.bool_)
            bad[rng.choice(len(priors), count, replace=False)] = True
            off = rng.normal(size=(count, d))
            off *= _BAD_METERS / np.linalg.norm(off, axis=1, keepdims=True)
            where = priors.measurements[:, :d].copy()
            where[bad] += off
            sigma = priors.information[0, 0, 0] ** -0.5
            wrong = fixed.with_priors(masat.gps(priors.ids, where, sigma))
            start = perf_counter()
            clean = masat.solve(
                wrong.with_priors(masat.gps(priors.ids[~bad], where[~bad], sigma)), threads=1
            )
            plain = perf_counter() - start
            start = perf_counter()
            found = masat.solve(wrong, robust=True, threads=1)
            seconds = perf_counter() - start
            assert found.decision is not None
            kept = found.decision.kept_priors
            apart = np.square(found.poses[:, :d] - clean.poses[:, :d]).sum(axis=1).mean() ** 0.5
            counts = np.sum(kept & bad), np.sum(~kept & ~bad), np.sum(~found.decision.kept)
            rows.append((*counts, apart, seconds, seconds / plain))
        table = np.array(rows)
        kept, rejected, closures = table[:, :3].sum(axis=0).astype(int)
        seconds, units = np.median(table[:, 4:], axis=0)
        print(
            f"{Path(name).name:24} {trials:6d} {kept:6d} {rejected:9d} {closures:9d} "
            f"{table[:, 3].max():9.2e} {seconds:7.2f} {units:14.1f}",
            flush=True,
        )


def certificates(names: list[str]) -> None:
    """Print which maps are certified without fixes, with fixes, and with half the map turned."""
    print(f"{'graph':34} {'without':>10} {'with fixes':>10} {'half turned':>11}")
    kept = total = 0
    for name in names:
        graph = quietly_read(DATA / name)
        alone = masat.solve(graph, certify=True)
        fixed = masat.solve(with_fixes(alone, motion(0, graph.dimension)), certify=True)
        wrong = masat.certify(fixed.graph.with_poses(half_turned(fixed.poses)), search=False)
        status = [_status(result) for result in (alone, fixed)]
        total += status[0] == "optimal"
        kept += status == ["optimal", "optimal"]
        print(f"{name:34} {status[0]:>10} {status[1]:>10} {wrong.status:>11}", flush=True)
    print(f"certified with fixes: {kept} of the {total} that are without")


def _status(result: masat.Result) -> str:
    return "-" if result.certificate is None else result.certificate.status


def half_turned(poses: Floats) -> Floats:
    """Return poses of which the second half is turned by half a turn about its first one."""
    d = 2 if poses.shape[1] == 3 else 3
    middle = len(poses) // 2
    about = np.array([*poses[middle, :d], np.pi] if d == 2 else [*poses[middle, :d], 0, 0, 1, 0])
    origin = lie.identity(d)
    origin[:d] = poses[middle, :d]
    out = poses.copy()
    out[middle:] = lie.compose(lie.compose(about, lie.inverse(origin)), poses[middle:])
    return out


def public_graphs() -> list[str]:
    """Return all graphs of the data folders of 2D and 3D."""
    return sorted(
        str(path.relative_to(DATA))
        for folder in ("2d", "3d")
        for path in (DATA / folder).iterdir()
        if path.name.endswith(_SUFFIXES)
    )


def main() -> None:
    """Print one table."""
    single_threaded()
    warnings.simplefilter("ignore", masat.MasatWarning)
    parser = argparse.ArgumentParser(prog="python -m benchmarks.fixes")
    parser.add_argument("table", choices=("cost", "offsets", "certificates", "robust"))
    parser.add_argument("graphs", nargs="*")
    parser.add_argument("--trials", type=int, default=100)
    arguments = parser.parse_args(sys.argv[1:])
    if arguments.table == "cost":
        cost(arguments.graphs or list(_GRAPHS))
    elif arguments.table == "offsets":
        offsets(arguments.graphs or list(_GRAPHS), arguments.trials)
    elif arguments.table == "robust":
        robust(arguments.graphs or list(_GRAPHS), min(arguments.trials, 20))
    else:
        certificates(arguments.graphs or public_graphs())


if __name__ == "__main__":
    main()
