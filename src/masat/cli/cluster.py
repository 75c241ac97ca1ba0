"""Connecting to a Dask cluster."""

from __future__ import annotations

from typing import Any

from masat.errors import MasatError


def connect(scheduler: str, error: type[MasatError]) -> Any:
    """Return a client of the cluster whose scheduler has an address, such as tcp://host:8786."""
    try:
        import distributed
    except ImportError:
        raise error("--scheduler needs Dask: pip install 'masat[cluster]'") from None
    try:
        return distributed.Client(scheduler, timeout="20s")  # type: ignore[no-untyped-call]
    except (OSError, ValueError, TimeoutError) as reason:
        raise error(f"no Dask scheduler answers at {scheduler}: {reason}") from None
