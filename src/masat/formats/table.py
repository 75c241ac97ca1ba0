"""What a format is: a table of records for the core's parser, and perhaps a writer."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from masat._core import InformationText, Kind, PoseText, Record

if TYPE_CHECKING:
    from masat.graph import PoseGraph

__all__ = ["Format", "InformationText", "Kind", "PoseText", "Record"]


@dataclass(frozen=True)
class Format:
    """A text format for pose graphs.

    Attributes
    ----------
    name : str
        By which callers choose it.
    summary : str
        One line for people.
    records : tuple of Record
        What each tag means; lines with other tags are counted and passed over.
    columns : tuple of int
        Of lines without a tag, if the format has such.
    format_graph : callable or None
        Makes the text of a graph.
    """

    name: str
    summary: str
    records: tuple[Record, ...]
    columns: tuple[int, ...] = ()
    format_graph: Callable[[PoseGraph], bytes] | None = None

    def tags(self) -> set[bytes]:
        """Return the tags, in the words of `count_tags`."""
        return {r.tag.encode() for r in self.records if r.tag} | {
            f"{n} columns".encode() for n in self.columns
        }
