"""A figure that notebooks show; imported only when something is drawn, since matplotlib is slow."""

from __future__ import annotations

import io
from typing import Any

from matplotlib import rc_context
from matplotlib.figure import Figure

_NO_DATES: dict[str, dict[str, Any]] = {"pdf": {"CreationDate": None}, "svg": {"Date": None}}
# TrueType fonts, which journals ask for, and identifiers that do not change.
_VECTORS: dict[Any, Any] = {"pdf.fonttype": 42, "svg.hashsalt": "masat"}


class Picture(Figure):
    """A matplotlib figure that Jupyter displays without pyplot.

    pyplot keeps every figure it makes until it is closed. Without pyplot, nothing tells Jupyter how
    to show a figure unless the figure itself does.
    """

    def encode(self, file_format: str = "png") -> bytes:
        """Return the picture in a format that matplotlib writes, such as png, pdf or svg.

        The same picture gives the same bytes: files have no dates. Text in a PDF stays text.
        """
        buffer = io.BytesIO()
        with rc_context(_VECTORS):
            self.savefig(buffer, format=file_format, metadata=_NO_DATES.get(file_format))
        return buffer.getvalue()

    def _repr_png_(self) -> bytes:
        return self.encode()
