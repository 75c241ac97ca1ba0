"""Tables, JSON and figures for people and machines."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import click

from masat.display import duration, number
from masat.optimality.certificate import Certificate
from masat.optimizers import Result

__all__ = ["as_json", "duration", "number", "rows", "status", "summary", "table", "weight_counts"]

_COLORS = {"optimal": "green", "undecided": "yellow", "refuted": "red"}


def as_json(values: dict[str, Any]) -> None:
    """Print a JSON object."""
    click.echo(json.dumps(values, indent=2))


def rows(pairs: Sequence[tuple[str, str]]) -> None:
    """Print names and what there is to say of them."""
    width = max(len(name) for name, _ in pairs) + 1
    for name, text in pairs:
        click.echo(f"{name:<{width}} {text}")


def table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table, its first column to the left, the others to the right."""
    from rich import box
    from rich.console import Console
    from rich.table import Table

    grid = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for k, column in enumerate(columns):
        grid.add_column(column, justify="right" if k else "left", no_wrap=True)
    for row in rows:
        grid.add_row(*row)
    console = Console()
    # A pipe has no width: nothing is cut off there.
    Console(width=None if console.is_terminal else 160).print(grid)


def status(certificate: Certificate) -> str:
    """Return the status of a certificate, colored where colors are shown."""
    return click.style(certificate.status, fg=_COLORS[certificate.status])


def weight_counts(result: Result) -> dict[str, int] | None:
    """Return how many edges a loss believed, doubted and ignored; None without a loss."""
    if result.weights is None:
        return None
    w = result.weights
    return {
        "at_least_half": int((w >= 0.5).sum()),
        "less": int(((w > 0) & (w < 0.5)).sum()),
        "zero": int((w == 0).sum()),
    }


def summary(result: Result) -> dict[str, Any]:
    """Return what JSON says of a result."""
    return {
        "optimizer": result.method,
        "converged": result.converged,
        "reason": result.reason.name.lower(),
        "message": result.message,
        "iterations": result.iterations,
        "initial_chi2": result.initial_chi2,
        "chi2": result.chi2,
        "degrees_of_freedom": result.degrees_of_freedom,
        "reduced_chi2": result.reduced_chi2,
        "loss": result.loss,
        "robust_cost": result.robust_cost,
        "weights": weight_counts(result),
        "gauge": result.gauge.tolist(),
        "seconds": result.seconds,
        "history": [iteration._asdict() for iteration in result.history],
    }
