"""Reading and MASAT against gtsam's `readG2o` of the same file, single-threaded.

Run `python -m benchmarks.start`; needs the extra `bench`, and the data (MASAT_DATA).
"""

from __future__ import annotations

import tempfile
from functools import partial
from pathlib import Path

import gtsam

import masat
from benchmarks.data import medians, plain_copy
from benchmarks.graphs import unused

# How many times slower readG2o must be than MASAT. The authors' program at -O2 took about
# 1/2, 2/3 and 1/3 of readG2o's time.
GRAPHS = {
    "2d/input_M3500_g2o.g2o": 40,
    "2d/city10000.g2o": 40,
    "2d/10kHog-man.txt.gz": 80,
}
READING = 5


def _first_time(graph: masat.PoseGraph) -> masat.PoseGraph:
    """Initialize a copy, which has not built its adjacency yet."""
    return masat.initialize(unused(graph), "masat")


def main() -> None:
    """Print a table of medians and ratios."""
    print("medians in ms; ratios to gtsam's readG2o, wanted in brackets")
    print(
        f"{'graph':<24}{'readG2o':>9}{'read':>8}{'ratio':>13}{'masat':>8}{'ratio':>14}"
        f"{'first time':>12}{'ratio':>8}"
    )
    with tempfile.TemporaryDirectory() as folder:
        for name, wanted in GRAPHS.items():
            path = plain_copy(name, Path(folder))
            graph = masat.read(path)
            took = medians(
                {
                    "gtsam": partial(gtsam.readG2o, str(path), False),
                    "read": partial(masat.read, path),
                    "masat": partial(masat.initialize, graph, "masat"),
                    "first": partial(_first_time, graph),
                },
            )
            ratio = {key: took["gtsam"] / value for key, value in took.items()}
            print(
                f"{Path(name).name:<24}{took['gtsam']:>9.1f}{took['read']:>8.2f}"
                f"{ratio['read']:>7.1f} ({READING:>3})"
                f"{took['masat']:>8.3f}{ratio['masat']:>8.0f} ({wanted:>3})"
                f"{took['first']:>12.3f}{ratio['first']:>8.0f}"
            )


if __name__ == "__main__":
    main()
