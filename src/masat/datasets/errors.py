"""The error of the datasets."""

from __future__ import annotations

from masat.errors import MasatError


class DatasetError(MasatError):
    """A dataset that is unknown, cannot be downloaded, or has a wrong checksum."""
