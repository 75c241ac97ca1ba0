"""The lines of a TOML file on which its keys and the elements of its lists are."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from typing import Any, TypeAlias

from masat.study.names import StudyError

_Tree: TypeAlias = tuple[int, list["_Tree"]]
"""Offset of a value, and the same of its elements."""

_TOKEN = re.compile(
    r'"""(?s:.*?)"""'
    r"|'''(?s:.*?)'''"
    r'|"(?:\\.|[^"\\\n])*"'
    r"|'[^'\n]*'"
    r"|(?P<comment>\#[^\n]*)"
    r"|[\[\],]"
    r"|[^\s\[\],\#\"']+"
)
_PLACE = re.compile(r" \(at (?:line (\d+), column \d+|end of document)\)$")


class TomlText:
    """The text of a TOML file, for errors that name the file and the line.

    Parameters
    ----------
    path : str
        Name of the file in errors.
    text : str
        What the file holds; empty for a table from elsewhere, whose errors then name no line.
    """

    def __init__(self, path: str, text: str) -> None:
        self.path = path
        self.text = text

    def parse(self) -> dict[str, Any]:
        """Return the table that the text holds; a StudyError names the line that is not TOML."""
        try:
            return tomllib.loads(self.text)
        except RecursionError:
            raise StudyError(f"{self.path}: lists are nested too deeply") from None
        except tomllib.TOMLDecodeError as error:
            return self._refuse(str(error))
        except ValueError:  # Python does not convert integers of thousands of digits
            long = re.search(r"\d{1000,}", self.text)
            line = self._line_at(long.start()) if long else 1
            raise StudyError(f"{self.path}:{line}: a number has too many digits") from None

    def error(self, message: str, key: str | None = None, *indices: int) -> StudyError:
        """Return an error on the line of a key, or of an element of the key's list.

        Parameters
        ----------
        message : str
            What is wrong.
        key : str, optional
            The key at fault. Without it, or if the file lacks it, the error names the file alone.
        *indices : int
            Indices of the element in the list of the key, of an element of that, and so on.
        """
        line = None if key is None else self._line(key, *indices)
        where = self.path if line is None else f"{self.path}:{line}"
        return StudyError(f"{where}: {message}")

    def _refuse(self, message: str) -> dict[str, Any]:
        place = _PLACE.search(message)
        message = _PLACE.sub("", message)
        if message == "Cannot overwrite a value":
            message = "a key is given twice"
        last = self.text.count("\n") + 1
        line = int(place[1]) if place and place[1] else last
        raise StudyError(f"{self.path}:{line}: not a TOML file: {message}")

    def _line(self, key: str, *indices: int) -> int | None:
        found = re.search(
            rf"(?m)^[ \t]*\[*[ \t]*[\"']?{re.escape(key)}[\"']?[ \t]*[=.\]]", self.text
        )
        if found is None:
            return None
        line = self._line_at(found.end() - 1)
        tokens = _tokens(self.text, found.end())
        first = next(tokens, None)
        if not indices or first is None:
            return line
        tree = _tree(first, tokens)
        for index in indices:
            if index >= len(tree[1]):
                break
            tree = tree[1][index]
        return self._line_at(tree[0])

    def _line_at(self, offset: int) -> int:
        return self.text.count("\n", 0, offset) + 1


def _tokens(text: str, offset: int) -> Iterator[re.Match[str]]:
    return (t for t in _TOKEN.finditer(text, offset) if t["comment"] is None)


def _tree(first: re.Match[str], tokens: Iterator[re.Match[str]]) -> _Tree:
    """Return the offsets of a value that begins with a token, and of its elements."""
    elements: list[_Tree] = []
    if first[0] == "[":
        for token in tokens:
            if token[0] == "]":
                break
            if token[0] != ",":
                elements.append(_tree(token, tokens))
    return first.start(), elements
