"""A map in parts against the same map in one process: chi2, times, and the peak memory of each.

    python -m benchmarks.partition [--world city] [--poses N] [--parts N] [--workers N] [--memory B]

With workers, a Dask LocalCluster solves the parts; with --workers 0 one process solves them one
after the other, its factors limited to --memory bytes. Seconds are wall time, beside those of all
processors together, which tell more on a busy machine. Needs Linux, for the peaks of memory.

    python -m benchmarks.partition --losses RUNS [--poses N] [--parts N] [--workers N]

kills two workers at random moments in each run, and compares the poses with those of an undisturbed
solve.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
from importlib import import_module
from pathlib import Path
from threading import Timer
from time import perf_counter, process_time
from typing import Any

import numpy as np

import masat
from benchmarks.threads import single_threaded
from masat.formats.streaming import read_mapped
from masat.worlds import city, perturb, sphere

_NOISE = {"city": (0.05, 0.05, 0.02), "sphere": (0.05, 0.02)}
_WORLDS = {"city": city, "sphere": sphere}


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--world", choices=_WORLDS, default="city")
    parser.add_argument("--poses", type=int, default=100_000)
    parser.add_argument("--parts", type=int, default=8)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--memory", type=int)
    parser.add_argument("--optimizer", default="gn")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--without-baseline", action="store_true")
    parser.add_argument("--losses", type=int)
    parser.add_argument("--step", nargs=2, help=argparse.SUPPRESS)
    options = parser.parse_args()
    single_threaded()
    if options.step is not None:
        name, folder = options.step
        found = _STEPS[name](Path(folder), options)
        print(json.dumps(found | {"peak": peak()}))
        return
    if options.losses is not None:
        lose_workers(options)
        return
    with tempfile.TemporaryDirectory() as folder:
        print(
            f"{options.world} of {options.poses} poses, {options.parts} parts, {options.optimizer}"
        )
        print(f"{'':<28}{'seconds':>9}{'CPU s':>9}{'peak MB':>9}")
        row("simulate", run("simulate", folder))
        whole = None
        if not options.without_baseline:
            whole = run("whole", folder)
            row(f"one process, {options.threads} threads", whole)
        row("partition", run("partition", folder))
        parted = run("solve", folder)
        row(f"parts on {options.workers} workers" if options.workers else "parts in turn", parted)
        for k, worker in enumerate(parted["workers"]):
            print(f"{f'  worker {k}':<46}{worker / 1e6:>9.0f}")
        if options.workers:
            print(f"{'  the same again':<28}{parted['again']:>9.2f}")
        print(f"chi2 {parted['chi2']:.10g} after {parted['iterations']} iterations")
        if whole is not None:
            compare(whole, parted)


def compare(whole: dict[str, Any], parted: dict[str, Any]) -> None:
    """Print the ratios."""
    print(f"chi2 of one process {whole['chi2']:.10g} after {whole['iterations']} iterations")
    print(f"relative difference of chi2 {abs(parted['chi2'] / whole['chi2'] - 1):.1e}")
    print(
        f"time to that of one process {parted['seconds'] / whole['seconds']:.2f}, "
        f"of all processors {parted['cpu'] / whole['cpu']:.2f}"
    )
    if parted["workers"]:
        largest = max(parted["workers"])
        print(f"peak of the largest worker to that of one process {largest / whole['peak']:.2f}")
        print(f"peak of the client to that of one process {parted['peak'] / whole['peak']:.2f}")
    else:
        print(f"peak to that of one process {parted['peak'] / whole['peak']:.2f}")


def run(step: str, folder: str) -> dict[str, Any]:
    """Run a step in a process of its own."""
    command = [sys.executable, "-m", "benchmarks.partition", *sys.argv[1:], "--step", step, folder]
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


def row(name: str, found: dict[str, Any]) -> None:
    """Print a row."""
    times = f"{found['seconds']:>9.2f}{found['cpu']:>9.2f}"
    print(f"{name:<28}{times}{found['peak'] / 1e6:>9.0f}", flush=True)


def simulate(folder: Path, options: argparse.Namespace) -> dict[str, Any]:
    """Write a graph with an initial guess."""
    begin = perf_counter()
    graph = perturb(_WORLDS[options.world](options.poses), _NOISE[options.world])
    masat.write(masat.initialize(graph, "masat"), folder / "graph.g2o")
    return {"seconds": perf_counter() - begin, "cpu": process_time()}


def whole(folder: Path, options: argparse.Namespace) -> dict[str, Any]:
    """Solve the graph in one process."""
    graph = masat.read(folder / "graph.g2o")
    begin = process_time()
    result = masat.optimize(graph, options.optimizer, threads=options.threads)
    return {
        "seconds": result.seconds,
        "cpu": process_time() - begin,
        "chi2": result.chi2,
        "iterations": result.iterations,
    }


def partition(folder: Path, options: argparse.Namespace) -> dict[str, Any]:
    """Cut the graph into parts."""
    begin = perf_counter()
    mapped = folder / "mapped"
    mapped.mkdir()
    graph = read_mapped(folder / "graph.g2o", mapped)
    masat.partition(graph, folder / "parts", options.parts)
    return {"seconds": perf_counter() - begin, "cpu": process_time()}


def solve(folder: Path, options: argparse.Namespace) -> dict[str, Any]:
    """Solve the parts."""
    parts = masat.Partition(folder / "parts")
    begin, before, again = process_time(), 0.0, 0.0
    if options.workers == 0:
        result = parts.solve(options.optimizer, memory=options.memory)
        workers: list[int] = []
    else:
        import distributed

        with (
            distributed.LocalCluster(  # type: ignore[no-untyped-call]
                n_workers=options.workers,
                threads_per_worker=1,
                dashboard_address=None,
                memory_limit=None,
            ) as cluster,
            distributed.Client(cluster) as client,  # type: ignore[no-untyped-call]
        ):
            # The time of one process does not include its imports either.
            client.run(import_module, "masat.parts.tasks")
            before = sum(client.run(process_time).values())
            begin = process_time()
            result = parts.solve(options.optimizer, client=client)
            before -= sum(client.run(process_time).values())
            again = parts.solve(options.optimizer, client=client, restart=True).seconds
            workers = sorted(client.run(peak).values())
    return {
        "seconds": result.seconds,
        "cpu": process_time() - begin - before,
        "chi2": result.chi2,
        "iterations": result.iterations,
        "workers": workers,
        "again": again,
    }


_STEPS = {"simulate": simulate, "whole": whole, "partition": partition, "solve": solve}


def lose_workers(options: argparse.Namespace) -> None:
    """Kill two workers in each run; print whether the poses are the same."""
    import distributed

    random = np.random.default_rng(0)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        simulate(folder, options)
        partition(folder, options)
        parts = masat.Partition(folder / "parts")
        best, poses = parts.solve(options.optimizer), parts.poses()[1]
        limit = 0.0
        for k in range(options.losses + 1):
            with (
                distributed.LocalCluster(  # type: ignore[no-untyped-call]
                    n_workers=options.workers, threads_per_worker=1, dashboard_address=None
                ) as cluster,
                distributed.Client(cluster) as client,  # type: ignore[no-untyped-call]
            ):
                victims = random.permutation(list(client.run(os.getpid).values()))[:2].tolist()
                moments = random.uniform(0, limit, 2).tolist()
                timers = [
                    Timer(moment, os.kill, (pid, signal.SIGKILL))
                    for moment, pid in zip(moments, victims, strict=True)
                ]
                # The first run is undisturbed, and tells how long one takes.
                for timer in timers if k else []:
                    timer.start()
                found = parts.solve(options.optimizer, client=client, restart=True)
                for timer in timers:
                    timer.cancel()
            same = found.chi2 == best.chi2 and np.array_equal(parts.poses()[1], poses)
            when = ", ".join(f"{moment:.2f}" for moment in moments) if k else "no time"
            bits = "the same bits" if same else "OTHER BITS"
            print(f"killed after {when} s of {found.seconds:.2f} s: {bits}", flush=True)
            limit = limit or found.seconds


def peak() -> int:
    """Return the largest memory of this process so far, in bytes."""
    status = Path("/proc/self/status").read_text()
    return 1024 * int(status.split("VmHWM:")[1].split()[0])


if __name__ == "__main__":
    main()
