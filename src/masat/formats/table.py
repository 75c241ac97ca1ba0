"""The parts of a format: a table of records for the core's parser, and optionally a writer."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
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
        Name by which callers choose the format.
    summary : str
        One line that describes the format.
    records : tuple of Record
        Meaning of each tag. Lines with other tags are counted and skipped.
    skipped : mapping of str to str
        Tags whose lines are skipped knowingly, and what they hold.
    columns : tuple of int
        Number of columns of the lines without a tag, if the format has such lines.
    read_text : callable or None
        Function that reads a text that does not consist of lines, given the path for its errors.
    format_graph : callable or None
        Function that returns the text of a graph; None if the format can only be read.
    suffixes : tuple of str
        Suffixes of the files that are written in this format.
    needs : tuple of str
        What only graphs that have it can be written: "poses", "stamps".
    """

    name: str
    summary: str
    records: tuple[Record, ...]
    columns: tuple[int, ...] = ()
    read_text: Callable[[bytes, Path], PoseGraph] | None = None
    format_graph: Callable[[PoseGraph], bytes] | None = None
    suffixes: tuple[str, ...] = ()
    needs: tuple[str, ...] = ()
    skipped: Mapping[str, str] = field(default_factory=dict)

    def tags(self) -> set[bytes]:
        """Return the tags as `count_tags` names them."""
        return {r.tag.encode() for r in self.records if r.tag} | {
            f"{n} columns".encode() for n in self.columns
        }
