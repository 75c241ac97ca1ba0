"""All formats, and how the format of a text is recognized."""

from __future__ import annotations

from pathlib import Path

from masat import _core
from masat.errors import FormatError
from masat.formats import g2o, isam, jrl, kitti, toro, tum, untagged
from masat.formats.table import Format

# Where two formats know equally many lines of a file, the earlier one is taken. A TORO file with
# EDGE2 has VERTEX2 lines too, so a file with EDGE2 alone is iSAM's.
FORMATS: dict[str, Format] = {
    f.name: f
    for f in (
        g2o.FORMAT,
        isam.FORMAT,
        toro.FORMAT,
        tum.FORMAT,
        kitti.FORMAT,
        untagged.TRAJECTORY,
        untagged.EDGE_LIST,
        jrl.FORMAT,
    )
}


def printable(tag: bytes) -> str:
    """Return a tag as a short ASCII string that a terminal can show."""
    text = "".join(chr(c) if 32 <= c < 127 else "?" for c in tag[:40])
    return text + ("..." if len(tag) > 40 else "")


def recognize(text: bytes, path: Path) -> tuple[Format, list[str]]:
    """Return the format that knows most lines of a text, and the names of those that know as many.

    Raises
    ------
    FormatError
        If the text is binary or empty, or no format knows any of its lines.
    """
    if b"\0" in text[:4096]:
        raise FormatError("a binary file, expected the text of a pose graph", path)
    if text[:4096].lstrip().startswith(b"{"):
        return jrl.FORMAT, []
    counts = _core.count_tags(text)
    if not counts:
        raise FormatError("the file is empty, expected the lines of a pose graph", path)
    known = {name: sum(counts.get(tag, 0) for tag in form.tags()) for name, form in FORMATS.items()}
    most = max(known.values())
    if most == 0:
        seen = ", ".join(printable(tag) for tag in list(counts)[:5])
        raise FormatError(
            f"no line of a pose graph found; its lines begin with: {seen}; known formats: "
            + ", ".join(FORMATS),
            path,
        )
    best, *rivals = [name for name, count in known.items() if count == most]
    return FORMATS[best], rivals
