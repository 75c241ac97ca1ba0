"""A document of headings, paragraphs, tables and figures, rendered as Markdown or HTML."""

from __future__ import annotations

import base64
import csv
import html
import io
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

from masat.display import table_html


@dataclass(frozen=True)
class Heading:
    """A heading; level 1 is the title."""

    text: str
    level: int = 2


@dataclass(frozen=True)
class Paragraph:
    """Running text."""

    text: str


@dataclass(frozen=True)
class Table:
    """A table, also written as `name`.csv."""

    name: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def _repr_html_(self) -> str:
        return table_html(self.columns, self.rows)

    def csv(self) -> str:
        """Return the table as CSV."""
        buffer = io.StringIO()
        csv.writer(buffer, lineterminator="\n").writerows([self.columns, *self.rows])
        return buffer.getvalue()


@dataclass(frozen=True)
class Figure:
    """A picture, a file beside the document: SVG or PNG. A PDF of the same name lies beside it."""

    path: Path
    caption: str


@dataclass(frozen=True)
class Embedded:
    """An interactive page, a file beside the document."""

    path: Path
    caption: str


Block: TypeAlias = Heading | Paragraph | Table | Figure | Embedded

_MEDIA_TYPES = {".png": "image/png", ".svg": "image/svg+xml"}
_VIEW_HEIGHT = 560  # pixels


def markdown(blocks: list[Block]) -> str:
    """Return the document as Markdown that refers to its pictures."""
    parts = []
    for block in blocks:
        match block:
            case Heading(text, level):
                parts.append(f"{'#' * level} {text}")
            case Paragraph(text):
                parts.append(text)
            case Figure(path, caption):
                parts.append(f"![{caption}]({path.name})\n\n*{caption}*")
            case Embedded(path, caption):
                parts.append(f"[{caption}]({path.name})")
            case Table(_, columns, rows):
                lines = [columns, ("---",) * len(columns), *rows]
                parts.append("\n".join(f"| {' | '.join(map(_cell, line))} |" for line in lines))
    return "\n\n".join(parts) + "\n"


def _cell(text: str) -> str:
    """Return text that does not end the cell or the line of a Markdown table."""
    return " ".join(text.split()).replace("|", "\\|")


_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 75rem; margin: 2rem auto; padding: 0 1rem; }
table { border-collapse: collapse; margin: 1rem 0; font-variant-numeric: tabular-nums; }
th, td { padding: .15rem .6rem; text-align: right; border-bottom: 1px solid #ddd; }
th:first-child, td:first-child { text-align: left; }
img { max-width: 100%; } img[src^="data:image/svg"] { width: 62rem; }
iframe { width: 100%; border: 1px solid #ddd; } figcaption { color: #555; }
"""


def page(blocks: list[Block]) -> str:
    """Return the document as one HTML file, pictures and interactive pages included."""
    title, parts = "", []
    for block in blocks:
        match block:
            case Heading(text, level):
                title = title or text
                parts.append(f"<h{level}>{html.escape(text)}</h{level}>")
            case Paragraph(text):
                parts.append(f"<p>{html.escape(text)}</p>")
            case Figure(path, caption):
                data = base64.b64encode(path.read_bytes()).decode()
                text = html.escape(caption)
                parts.append(
                    f'<figure><img alt="{text}" src="data:{_MEDIA_TYPES[path.suffix]};base64,'
                    f'{data}"><figcaption>{text}</figcaption></figure>'
                )
            case Embedded(path, caption):
                inside = html.escape(path.read_text(encoding="utf-8"))
                parts.append(
                    f'<figure><iframe srcdoc="{inside}" title="{html.escape(caption)}" '
                    f'loading="lazy" height="{_VIEW_HEIGHT}"></iframe>'
                    f"<figcaption>{html.escape(caption)}</figcaption></figure>"
                )
            case Table():
                parts.append(table_html(block.columns, block.rows))
    return (
        f'<!doctype html>\n<html lang="en"><meta charset="utf-8"><title>{html.escape(title)}'
        f"</title><style>{_STYLE}</style>\n" + "\n".join(parts) + "\n</html>\n"
    )
