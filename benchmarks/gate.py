"""Fails where a ratio to a peer has got worse than the baseline.

Run `python -m benchmarks.gate`; `--update` rewrites the baseline. Takes about a minute, and more
where something fails: other work on the machine spoils a ratio now and then, so only what is too
large each time of three has got worse. Ratios differ from machine to machine (vector units, caches)
by more than the tolerance: a baseline holds on the machine that it is from.
"""

from __future__ import annotations

import json
import statistics
import sys
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

import gtsam

import masat
from benchmarks.data import medians
from benchmarks.factor import measure
from benchmarks.graphs import CASES, graph_of
from benchmarks.solvers import iterations
from benchmarks.threads import single_threaded

BASELINE = Path(__file__).with_name("baseline.json")
TOLERANCE = 0.3
TIMES = 3

_FACTOR = ("M3500", "city10000", "10kHog-man", "sphere2500", "torus3D", "parking-garage")
_ITERATION = ("M3500", "city10000", "parking-garage", "sphere2500")
_START = ("M3500", "city10000")


def factorize(name: str) -> dict[str, float]:
    """Compare the numeric factorization with CHOLMOD's."""
    return {f"factorize {name} / CHOLMOD": measure(graph_of(name)).ratio}


def iterate(folder: Path, name: str) -> dict[str, float]:
    """Compare a Gauss-Newton iteration with gtsam's and g2o's."""
    took = iterations(CASES[name], folder)
    return {f"iterate {name} / {peer}": took["masat"] / took[peer] for peer in ("gtsam", "g2o")}


def start(folder: Path, name: str) -> dict[str, float]:
    """Compare reading and MASAT with gtsam's reader."""
    file = CASES[name].plain(folder)
    graph = masat.read(file)
    took = medians(
        {
            "gtsam": partial(gtsam.readG2o, str(file), False),
            "read": partial(masat.read, file),
            "masat": partial(masat.initialize, graph, "masat"),
        }
    )
    return {f"{t} {name} / gtsam's readG2o": took[t] / took["gtsam"] for t in ("read", "masat")}


def measurements(folder: Path) -> list[Callable[[], dict[str, float]]]:
    """Return what is measured: each gives ratios of masat's time to a peer's, in one go."""
    return [
        *(partial(factorize, name) for name in _FACTOR),
        *(partial(iterate, folder, name) for name in _ITERATION),
        *(partial(start, folder, name) for name in _START),
    ]


def update(folder: Path) -> None:
    """Write the baseline: of each ratio the median of three."""
    found: dict[str, float] = {}
    for measured in measurements(folder):
        several = [measured() for _ in range(TIMES)]
        for name in several[0]:
            found[name] = float(f"{statistics.median(one[name] for one in several):.3g}")
    BASELINE.write_text(json.dumps(found, indent=2) + "\n")
    print(f"{len(found)} ratios written")


def change(baseline: dict[str, float], name: str, now: float) -> float:
    """Return how much larger a ratio is than in the baseline; infinite where it has none."""
    return now / baseline[name] - 1 if name in baseline else float("inf")


def compare(folder: Path) -> int:
    """Print a table; return how many ratios are worse than the baseline."""
    baseline: dict[str, float] = json.loads(BASELINE.read_text())
    print(f"ratios of time, smaller is better; at most {TOLERANCE:.0%} above the baseline")
    print(f"{'ratio':<42}{'baseline':>10}{'now':>10}{'change':>9}")
    worse = 0
    for measured in measurements(folder):
        found = measured()
        for _ in range(TIMES - 1):
            if not any(change(baseline, name, found[name]) > TOLERANCE for name in found):
                break
            again = measured()
            found = {name: min(found[name], again[name]) for name in found}
        for name, now in found.items():
            failed = change(baseline, name, now) > TOLERANCE
            worse += failed
            print(
                f"{name:<42}{baseline.get(name, 0):>10.4f}{now:>10.4f}"
                f"{change(baseline, name, now):>+9.0%}{'  FAIL' if failed else ''}",
                flush=True,
            )
    print(f"{worse} worse" if worse else "none is worse")
    return worse


def main() -> None:
    """Compare with the baseline, or rewrite it."""
    single_threaded()
    with tempfile.TemporaryDirectory() as folder:
        if "--update" in sys.argv:
            update(Path(folder))
        elif compare(Path(folder)):
            sys.exit(1)


if __name__ == "__main__":
    main()
