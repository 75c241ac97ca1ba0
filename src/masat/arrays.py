"""The element types of the package's arrays, and arrays that stay read-only.

The docstrings of the functions tell the shapes.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

AnyArray: TypeAlias = NDArray[Any]
Floats: TypeAlias = NDArray[np.float64]
Ids: TypeAlias = NDArray[np.int64]
Indices: TypeAlias = NDArray[np.int32]
Flags: TypeAlias = NDArray[np.bool_]
Labels: TypeAlias = NDArray[np.int64] | NDArray[np.str_]
Stamps: TypeAlias = NDArray[np.float64] | NDArray[np.int64]

_Scalar = TypeVar("_Scalar", bound=np.generic)


def locked(a: NDArray[_Scalar]) -> NDArray[_Scalar]:
    """Return a read-only array of the same memory that `flags.writeable = True` cannot unlock.

    An array that owns its memory can always be made writable. A view of a read-only buffer cannot.
    """
    a = np.asarray(a)  # also turns a memory map into a plain array
    if isinstance(a.base, memoryview) and a.base.readonly:
        return a
    return np.asarray(a.data.toreadonly())


@dataclass(frozen=True, eq=False, repr=False)
class LockedArrays:
    """A dataclass of arrays that are read-only from the start, in copies and in pickles too."""

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if value is not None:
                self.__dict__[field.name] = locked(value)

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        # Pickles do not keep the flag of an array.
        self.__post_init__()
