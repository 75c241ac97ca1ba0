"""Where the standard graphs lie, and how to time work on a busy machine."""

from __future__ import annotations

import gzip
import os
import statistics
from collections.abc import Callable
from pathlib import Path
from time import perf_counter

DATA = Path(os.environ.get("MASAT_DATA", Path(__file__).parents[2] / "shared" / "data"))


def plain_copy(name: str, folder: Path) -> Path:
    """Return the path of a data file without gzip, which not every reader knows."""
    source = DATA / name
    if source.suffix != ".gz":
        return source
    target = folder / f"{source.name}.g2o"
    target.write_bytes(gzip.decompress(source.read_bytes()))
    return target


def medians(tasks: dict[str, Callable[[], object]], rounds: int = 7) -> dict[str, float]:
    """Return each task's median time in ms.

    A round runs each task five times, the first uncounted: the rounds interleave the tasks, so that
    noise hits all alike, and the repetitions give each the warm caches that the others took away.
    """
    times: dict[str, list[float]] = {name: [] for name in tasks}
    for _ in range(rounds):
        for name, task in tasks.items():
            task()
            for _ in range(4):
                begin = perf_counter()
                task()
                times[name].append(1e3 * (perf_counter() - begin))
    return {name: statistics.median(values) for name, values in times.items()}
