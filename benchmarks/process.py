"""The whole process `masat solve FILE -o OUT --quiet`, against Python with NumPy alone.

Run `python -m benchmarks.process`; needs the data (MASAT_DATA).
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from functools import partial
from pathlib import Path

from benchmarks.data import medians
from benchmarks.graphs import CASES
from benchmarks.threads import single_threaded

GRAPHS = ("intel", "M3500", "city10000", "10kHog-man", "sphere2500", "torus3D")
# Of the solver's time on M3500 to that of the import.
WANTED = 3.5


def main() -> None:
    """Print a table of medians and ratios."""
    single_threaded()
    print("whole processes, medians in ms; ratio to the one that imports NumPy and does no more,")
    print(f"wanted at most {WANTED} on M3500")
    print(f"{'graph':<16}{'import numpy':>14}{'masat solve':>13}{'ratio':>7}")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for graph in GRAPHS:
            file = CASES[graph].plain(folder)
            solve = ["-m", "masat", "solve", str(file), "-o", str(folder / "map.g2o"), "--quiet"]
            took = medians({"numpy": run("-c", "import numpy"), "solve": run(*solve)}, rounds=3)
            print(
                f"{graph:<16}{took['numpy']:>14.0f}{took['solve']:>13.0f}"
                f"{took['solve'] / took['numpy']:>7.2f}"
            )


def run(*arguments: str) -> partial[object]:
    """Return a call that runs Python with the arguments."""
    return partial(subprocess.run, [sys.executable, *arguments], check=True)


if __name__ == "__main__":
    main()
