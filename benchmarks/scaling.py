"""Time and memory from the file to the map of simulated cities that grow.

Run `python -m benchmarks.scaling [--large]`: 10k and 100k poses, and a million with `--large`.
"""

from __future__ import annotations

import json
import resource
import statistics
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from time import perf_counter

import masat
from benchmarks.threads import single_threaded
from masat.worlds import city, perturb

SIZES = (10_000, 100_000)
LARGE = 1_000_000
NOISE = (0.05, 0.05, 0.02)
WANTED_PER_EDGE = 100


def solve(file: Path) -> dict[str, float]:
    """Go from the file to the map; return times in seconds, peak memory in bytes, the outcome."""
    begin = perf_counter()
    graph = masat.read(file)
    read = perf_counter()
    guess = masat.initialize(graph, "masat")
    first = perf_counter()
    result = masat.optimize(guess, "gauss_newton")
    done = perf_counter()
    # The process's peak, in kB on Linux; what follows does not count.
    peak = 1024.0 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    again = []
    for _ in range(5):
        begun = perf_counter()
        masat.initialize(graph, "masat")
        again.append(perf_counter() - begun)
    return {
        "poses": len(graph.ids),
        "edges": len(graph.edges),
        "read": read - begin,
        "first": first - read,
        "masat": statistics.median(again),
        "optimize": done - first,
        "total": done - begin,
        "peak": peak,
        "iterations": result.iterations,
        "converged": result.converged,
        "reduced": result.reduced_chi2 or 0.0,
    }


def measure(poses: int) -> dict[str, float]:
    """Simulate a city, and solve it in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "city.g2o"
        masat.write(replace(perturb(city(poses), NOISE), poses=None), file)
        command = [sys.executable, "-m", "benchmarks.scaling", "--solve", str(file)]
        done = subprocess.run(command, check=True, capture_output=True, text=True)
    found: dict[str, float] = json.loads(done.stdout)
    return found


def main() -> None:
    """Print a table."""
    if sys.argv[1:2] == ["--solve"]:
        print(json.dumps(solve(Path(sys.argv[2]))))
        return
    single_threaded()
    print(f"City worlds with noise {NOISE}, file to map by MASAT and Gauss-Newton, one thread")
    print(
        f"MASAT in ns an edge, wanted at most {WANTED_PER_EDGE}; `first` builds the adjacency too"
    )
    print(
        f"{'poses':>9}{'edges':>10}{'read s':>9}{'MASAT':>8}{'first':>8}{'GN s':>8}{'its':>5}"
        f"{'total s':>9}{'us/pose':>9}{'peak MB':>9}{'kB/pose':>9}{'chi2/dof':>10}"
    )
    for poses in (*SIZES, LARGE) if "--large" in sys.argv else SIZES:
        f = measure(poses)
        per_edge = 1e9 / f["edges"]
        print(
            f"{f['poses']:>9}{f['edges']:>10}{f['read']:>9.3f}{f['masat'] * per_edge:>8.0f}"
            f"{f['first'] * per_edge:>8.0f}{f['optimize']:>8.2f}{f['iterations']:>5}"
            f"{f['total']:>9.2f}{1e6 * f['total'] / f['poses']:>9.1f}{f['peak'] / 1e6:>9.0f}"
            f"{f['peak'] / 1e3 / f['poses']:>9.1f}{f['reduced']:>10.3f}"
            f"{'' if f['converged'] else '  did not converge'}",
            flush=True,
        )


if __name__ == "__main__":
    main()
