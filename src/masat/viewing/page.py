"""The HTML file of a view: one page with its style, its scripts and its data inside."""

from __future__ import annotations

import re
from functools import cache
from html import escape
from importlib.resources import files
from typing import Any

# Modules by their order: each uses only what stands above it.
MODULES = (
    "payload",
    "colors",
    "colorings",
    "format",
    "shaders",
    "layers",
    "ellipses",
    "tints",
    "camera",
    "model",
    "placement",
    "stack",
    "pace",
    "drawing",
    "picking",
    "details",
    "lists",
    "edits",
    "search",
    "legend",
    "panel",
    "keys",
    "main",
)
_IMPORT = re.compile(r"^import\s[^;]*?;\n", re.MULTILINE)
_EXPORT = re.compile(r"^export\s+(?=(?:async\s+)?(?:function|class|const|let)\b)", re.MULTILINE)


def page(payload: str, title: str) -> str:
    """Return the HTML of a view.

    Parameters
    ----------
    payload : str
        What `masat.viewing.payload.pack` returns.
    title : str
        Title of the window.

    Returns
    -------
    str
    """
    parts = {
        "title": escape(title),
        "style": _text("style.css"),
        "license": _text("vendor", "three.LICENSE"),
        "library": _text("vendor", "three.min.js"),
        "payload": payload,
        "script": _script(),
    }
    return re.sub(r"\{\{(\w+)\}\}", lambda name: parts[name[1]], _text("page.html"))


@cache
def _script() -> str:
    """Return all modules as one script: without imports, and with nothing exported.

    They share one scope, so no two of them may declare the same name at their top level.
    """
    modules = [_text("js", f"{name}.js") for name in MODULES]
    return "\n".join(_EXPORT.sub("", _IMPORT.sub("", text)) for text in modules)


@cache
def _text(*path: str) -> str:
    folder: Any = files("masat.viewing")
    text: str = folder.joinpath(*path).read_text(encoding="utf-8")
    return text
