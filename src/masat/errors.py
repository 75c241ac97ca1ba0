"""The errors and the warning of the package; every error it raises on purpose is a `MasatError`."""

from __future__ import annotations

from pathlib import Path
from typing import Any


class MasatError(Exception):
    """Base of the package's errors; its text says what is wrong, where, and what to do."""

    def __reduce__(self) -> tuple[Any, ...]:
        # By default an exception is unpickled from its text alone, which the errors below refuse.
        return _unpickled, (type(self), self.args, self.__dict__)


def _unpickled(kind: type[MasatError], args: tuple[Any, ...], state: dict[str, Any]) -> MasatError:
    error = kind.__new__(kind, *args)
    error.__dict__.update(state)
    return error


class GraphError(MasatError, ValueError):
    """The arrays do not make a pose graph.

    Attributes
    ----------
    edge : int or None
        Index of the first edge at fault.
    node : int or None
        Index, in the order of the input, of the first node at fault.
    """

    def __init__(self, message: str, *, edge: int | None = None, node: int | None = None) -> None:
        super().__init__(message)
        self.edge = edge
        self.node = node


class InformationError(GraphError):
    """Information matrices that are not symmetric positive definite.

    Attributes
    ----------
    count : int
        How many matrices are at fault; `edge` is the first.
    """

    def __init__(self, message: str, *, edge: int, count: int) -> None:
        super().__init__(message, edge=edge)
        self.count = count


class FormatError(MasatError, ValueError):
    """A file does not hold what its format promises.

    Attributes
    ----------
    path : Path
        The file.
    line : int or None
        Number of the line at fault, from 1.
    """

    def __init__(self, message: str, path: Path, line: int | None = None) -> None:
        where = f"{path}:{line}" if line is not None else f"{path}"
        super().__init__(f"{where}: {message}")
        self.path = path
        self.line = line


class InitializationError(MasatError, ValueError):
    """An initial guess cannot be made as asked."""


class OptimizationError(MasatError, ValueError):
    """An optimization cannot start as asked."""


class MasatWarning(UserWarning):
    """Something in the input was passed over, assumed or bridged; the result is still valid."""
