"""A figure that notebooks show; imported only when something is drawn, since matplotlib is slow."""

from __future__ import annotations

import io

from matplotlib.figure import Figure


class Picture(Figure):
    """A matplotlib figure that Jupyter displays without pyplot.

    pyplot keeps every figure it makes until it is closed. Without pyplot, nothing tells Jupyter how
    to show a figure unless the figure itself does.
    """

    def encode(self, file_format: str = "png") -> bytes:
        """Return the picture in a format that matplotlib writes, such as png, pdf or svg."""
        buffer = io.BytesIO()
        self.savefig(buffer, format=file_format)
        return buffer.getvalue()

    def _repr_png_(self) -> bytes:
        return self.encode()
