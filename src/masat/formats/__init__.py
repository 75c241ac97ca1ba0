"""Reading and writing pose graphs; a format is one file here and one line of `FORMATS`."""

from __future__ import annotations

from masat.formats.edge_lists import read_edge_list
from masat.formats.links import read_links
from masat.formats.observations import read_observations
from masat.formats.reading import read
from masat.formats.registry import FORMATS
from masat.formats.writing import check_needs, format_of, write

__all__ = [
    "FORMATS",
    "check_needs",
    "format_of",
    "read",
    "read_edge_list",
    "read_links",
    "read_observations",
    "write",
]
