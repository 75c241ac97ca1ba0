"""What Jupyter shows of a graph, a result, a diagnosis and a certificate: a table and a picture."""

from __future__ import annotations

import base64
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from masat.graph import PoseGraph
from masat.residuals import chi2_per_edge

if TYPE_CHECKING:
    from masat.diagnostics import Diagnosis

# A picture of this many edges takes about 1.5 seconds on one core: a notebook must not wait longer.
_MAX_DRAWN_EDGES = 50_000
# A page of this many edges has about 2 MB, and a notebook holds one for each result that it shows.
_MAX_VIEWED_EDGES = 20_000
_LONGEST_LIST = 5
_LONGEST_CELL = 40
# Backgrounds of white text, readable in light and dark notebooks.
_COLORS = {
    "optimal": "#1a7f37",
    "refuted": "#cf222e",
    "undecided": "#57606a",
}

# A row is its name and a function for its text, since a text that cannot be made must not take
# the other rows with it.
_Row = tuple[str, Callable[[], object]]


def graph_html(graph: PoseGraph) -> str:
    """Return HTML with the sizes of a graph, its fixed nodes and chi2, and a picture of its poses.

    Like all functions of this module it escapes all text and never raises: a row that cannot be
    made says so, and a picture that cannot be made, or takes long, is left out with a row that
    says why.
    """
    rows: list[_Row] = [
        ("dimension", lambda: f"{graph.dimension}D"),
        ("nodes", lambda: f"{len(graph.ids):,}, ids {graph.ids[0]} to {graph.ids[-1]}"),
        ("edges", lambda: _edges(graph)),
        ("fixed", lambda: _list(graph.fixed) or "no node"),
        ("gauge", lambda: _list(graph.gauge)),
        ("chi2", lambda: _chi2(graph)),
        *_each("note", _attribute(graph, "notes")),
    ]
    return _html("PoseGraph", rows, graph)


def result_html(result: Any) -> str:
    """Return HTML with the outcome of an optimization, and an interactive view of the map.

    A large map gets a picture in place of the view, which would make the notebook large.
    """
    rows: list[_Row] = [
        ("graph", lambda: f"{result.graph.dimension}D, {len(result.graph.ids):,} nodes, "
                          f"{len(result.graph.edges):,} edges"),
        ("optimizer", lambda: getattr(result, "optimizer", None) or result.method),
        ("converged", lambda: "yes" if result.converged else "no"),
        ("stopped", lambda: result.message),
        ("chi2", lambda: f"{result.initial_chi2:.6g} → {result.chi2:.6g}"),
        ("reduced chi2", lambda: number(result.reduced_chi2)),
        *([] if _attribute(result, "robust_cost") is None else [
            ("robust cost", lambda: f"{number(result.robust_cost)} with {result.loss}")]),
        ("iterations", lambda: len(result.history)),
        ("time", lambda: f"{result.seconds:.3g} s"),
        ("gauge", lambda: _list(result.gauge)),
    ]  # fmt: skip
    graph = _attribute(result, "graph")
    page = _view(result, graph)
    return (
        f"<div>{_html('Result', rows, None)}{page}</div>" if page else _html("Result", rows, graph)
    )


def diagnosis_html(diagnosis: Diagnosis) -> str:
    """Return HTML with the figures of a diagnosis and its issues."""
    d = diagnosis
    rows: list[_Row] = [
        ("dimension", lambda: f"{d.dimension}D"),
        ("nodes", lambda: f"{d.nodes:,}, ids {d.ids[0]} to {d.ids[1]}, {len(d.fixed)} fixed"),
        ("edges", lambda: f"{d.edges:,}: {d.odometry_edges:,} odometry, "
                          f"{d.loop_closures:,} loop closures"),
        ("components", lambda: f"{len(d.components)}, of {_list(d.components)} nodes"),
        ("degree", lambda: f"{d.degree[0]} to {d.degree[2]} edges at a node"),
        ("information", lambda: f"eigenvalues {d.information[0]:.4g} to {d.information[1]:.4g}"),
        ("chi2", lambda: number(d.chi2)),
        ("reduced chi2", lambda: number(d.reduced_chi2)),
        ("largest chi2", lambda: ", ".join(f"{a} → {b} ({c:.3g})" for a, b, c in d.worst_edges)),
        *_each("issue", _attribute(d, "issues")),
    ]  # fmt: skip
    return _html("Diagnosis", rows, None)


def certificate_html(certificate: Any) -> str:
    """Return HTML with what a certificate says, and a picture of better poses if it knows some."""
    c = certificate
    status = str(_attribute(c, "status") or "")
    rows: list[_Row] = [
        ("certified", lambda: "yes" if c.certified else "no"),
        ("meaning", lambda: c.message),
        ("chi2", lambda: number(c.chi2)),
        ("lower bound", lambda: number(c.bound)),
        ("gap", lambda: number(c.gap)),
        ("caution", lambda: c.caveat or ""),
    ]
    better = _attribute(c, "better")
    if better is not None:
        rows.append(("better poses", lambda: f"chi2 {_chi2(better)}, in the picture"))
    return _html("Certificate", rows, better, status)


def table_html(
    columns: Sequence[str], rows: Iterable[Sequence[str]], remarks: Iterable[str] = ()
) -> str:
    """Return a table as HTML, and remarks below it.

    The first column and those of sentences are aligned to the left, the others to the right.
    """
    body = list(rows)
    styles = [
        "text-align:left;max-width:40em"
        if holds_sentences(row[k] for row in body)
        else f"text-align:{'right' if k else 'left'};white-space:nowrap"
        for k in range(len(columns))
    ]
    lines = [_cells("th", columns, styles), *(_cells("td", row, styles) for row in body)]
    below = "".join(f"<div>{escape(text)}</div>" for text in remarks)
    return f"<div><table>{''.join(lines)}</table>{below}</div>"


def holds_sentences(cells: Iterable[str]) -> bool:
    """Return whether a column of a table holds texts that are too long for one line."""
    return any(len(cell) > _LONGEST_CELL for cell in cells)


def _cells(tag: str, texts: Sequence[str], styles: Sequence[str]) -> str:
    inside = "".join(
        f'<{tag} style="{style}">{escape(text)}</{tag}>'
        for text, style in zip(texts, styles, strict=True)
    )
    return f"<tr>{inside}</tr>"


def _html(title: str, rows: list[_Row], drawn: PoseGraph | None, status: str = "") -> str:
    picture, why_not = _picture(drawn)
    if why_not:
        rows = [*rows, ("picture", lambda: why_not)]
    badge = ""
    if status:
        color = _COLORS.get(status, _COLORS["undecided"])
        badge = (
            f' <span style="background:{color};color:#fff;padding:1px 8px;border-radius:8px">'
            f"{escape(status)}</span>"
        )
    body = "".join(_row(name, text) for name, text in rows)
    return (
        '<div style="display:flex;flex-wrap:wrap;gap:1em;align-items:flex-start">'
        f"<div><b>{escape(title)}</b>{badge}<table>{body}</table></div>{picture}</div>"
    )


def _row(name: str, text: Callable[[], object]) -> str:
    try:
        shown = str(text())
    except Exception:
        shown = "not available"
    cell = '<td style="text-align:left;vertical-align:top;max-width:32em;white-space:normal">'
    return f"<tr>{cell}{escape(name)}</td>{cell}{escape(shown)}</td></tr>" if shown else ""


def _picture(graph: PoseGraph | None) -> tuple[str, str]:
    """Return an image element, or nothing and the reason why there is none."""
    if graph is None:
        return "", ""
    try:
        if graph.poses is None:
            return "", "none: the graph has no poses, masat.initialize gives it some"
        if len(graph.edges) > _MAX_DRAWN_EDGES:
            return "", f"none: more than {_MAX_DRAWN_EDGES:,} edges, masat.plot draws them"
        from masat.plotting import plot

        data = base64.b64encode(plot(graph, dpi=60).encode()).decode()
        return f'<img alt="map of the poses" src="data:image/png;base64,{data}"/>', ""
    except Exception as error:
        return "", f"none: {error}"


def _view(result: Any, graph: PoseGraph | None) -> str:
    """Return a frame with the interactive view of a result, or nothing."""
    try:
        if graph is None or len(graph.edges) > _MAX_VIEWED_EDGES:
            return ""
        from masat.viewing import view

        return view(result, title="map")._repr_html_()
    except Exception:
        return ""


def _each(name: str, texts: Any) -> list[_Row]:
    return [(name, partial(str, text)) for text in texts or ()]


def _attribute(of: Any, name: str) -> Any:
    try:
        return getattr(of, name, None)
    except Exception:
        return None


def _edges(graph: PoseGraph) -> str:
    ends = graph.edge_indices
    odometry = int((np.abs(ends[:, 0] - ends[:, 1]) == 1).sum())
    closures = len(ends) - odometry
    return f"{len(ends):,}: {odometry:,} odometry, {closures:,} loop closures"


def _chi2(graph: PoseGraph) -> str:
    if graph.poses is None:
        return "unknown: the graph has no poses"
    return f"{chi2_per_edge(graph).sum():.6g}"


def number(value: float | None) -> str:
    """Return six digits, or a dash."""
    return "-" if value is None else f"{value:.6g}"


def duration(seconds: float) -> str:
    """Return milliseconds or seconds."""
    return f"{seconds * 1e3:.3g} ms" if seconds < 1 else f"{seconds:.2f} s"


def _list(values: Any) -> str:
    shown = ", ".join(str(value) for value in values[:_LONGEST_LIST])
    more = len(values) - _LONGEST_LIST
    return f"{shown} and {more:,} more" if more > 0 else shown
