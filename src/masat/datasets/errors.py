"""The error of the datasets."""

from __future__ import annotations

from masat.errors import MasatError


class DatasetError(MasatError):
    """A dataset is not known, cannot be had, or is not what it should be."""
