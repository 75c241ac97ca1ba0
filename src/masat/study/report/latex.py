"""Tables of a report for LaTeX."""

from __future__ import annotations

import re

from masat.display import holds_sentences
from masat.study.report.document import Block, Heading, Paragraph, Table

_SPECIAL = {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    **{sign: f"\\{sign}" for sign in "&%$#_{}"},
}
_SENTENCES = r"p{0.6\linewidth}"
_SPECIALS = re.compile("|".join(map(re.escape, _SPECIAL)))


def latex(table: Table, caption: str) -> str:
    """Return a table as a floating table of LaTeX, with the rules of the package booktabs.

    Parameters
    ----------
    table : Table
        The table. Its label is "tab:" and its name.
    caption : str
        Plain text for the caption.
    """
    sides = [
        _SENTENCES if holds_sentences(row[k] for row in table.rows) else "r" if k else "l"
        for k in range(len(table.columns))
    ]
    lines = [
        "% In the preamble: \\usepackage{booktabs}",
        "\\begin{table}",
        "  \\centering",
        f"  \\caption{{{escaped(caption)}}}",
        f"  \\label{{tab:{table.name.replace('_', '-')}}}",
        f"  \\begin{{tabular}}{{{''.join(sides)}}}",
        "    \\toprule",
        _row(table.columns),
        "    \\midrule",
        *map(_row, table.rows),
        "    \\bottomrule",
        "  \\end{tabular}",
        "\\end{table}",
    ]
    return "\n".join(lines) + "\n"


def captions(blocks: list[Block], title: str) -> list[tuple[Table, str]]:
    """Return the tables of a document with captions: the title, and the text above each table."""
    found, heading, text = [], "", ""
    for block in blocks:
        match block:
            case Heading(heading, _):
                text = ""
            case Paragraph(text):
                pass
            case Table():
                parts = (title, heading, text)
                found.append((block, " ".join(f"{p.rstrip('.')}." for p in parts if p)))
    return found


def escaped(text: str) -> str:
    """Return text without what LaTeX takes for commands, on one line."""
    return _SPECIALS.sub(lambda sign: _SPECIAL[sign[0]], " ".join(text.split()))


def _row(cells: tuple[str, ...]) -> str:
    return "    " + " & ".join(map(escaped, cells)) + r" \\"
