"""The errors and the warning of the package; every error about its input is a `MasatError`."""

from __future__ import annotations

from pathlib import Path
from typing import Any


class MasatError(Exception):
    """Base class of the package's errors. The message says what is wrong, where, and what to do."""

    def __reduce__(self) -> tuple[Any, ...]:
        # By default an exception is unpickled from its text alone, which the errors below refuse.
        return _unpickled, (type(self), self.args, self.__dict__)


def _unpickled(kind: type[MasatError], args: tuple[Any, ...], state: dict[str, Any]) -> MasatError:
    error = kind.__new__(kind, *args)
    error.__dict__.update(state)
    return error


class GraphError(MasatError, ValueError):
    """Arrays that are not a valid pose graph, or sizes of a world that cannot be simulated.

    Attributes
    ----------
    edge : int or None
        Index of the first invalid edge, if the error is about an edge.
    node : int or None
        Index, in the order of the input, of the first invalid node, if the error is about a node.
    """

    def __init__(self, message: str, *, edge: int | None = None, node: int | None = None) -> None:
        super().__init__(message)
        self.edge = edge
        self.node = node


class InformationError(GraphError):
    """Information matrices that are zero or not symmetric positive semidefinite.

    Attributes
    ----------
    count : int
        Number of invalid matrices; `edge` is the first of them.
    """

    def __init__(self, message: str, *, edge: int, count: int) -> None:
        super().__init__(message, edge=edge)
        self.count = count


class FormatError(MasatError, ValueError):
    """A file that cannot be read, or written, in the format asked for.

    Attributes
    ----------
    path : Path
        The file.
    line : int or None
        Number of the invalid line, from 1, if the error is about a line.
    """

    def __init__(self, message: str, path: Path, line: int | None = None) -> None:
        where = f"{path}:{line}" if line is not None else f"{path}"
        super().__init__(f"{where}: {message}")
        self.path = path
        self.line = line


class InitializationError(MasatError, ValueError):
    """An initial guess that cannot be computed as asked."""


class OptimizationError(MasatError, ValueError):
    """An optimization that cannot start as asked."""


class PartitionError(MasatError, ValueError):
    """A graph that cannot be cut into parts as asked, or files of parts that do not fit."""


class EvaluationError(MasatError, ValueError):
    """A comparison with the truth that is not possible as asked."""


class MasatWarning(UserWarning):
    """Part of the input was skipped, assumed or repaired; the result is still valid."""
