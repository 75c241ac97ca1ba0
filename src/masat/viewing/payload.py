"""What a view draws, packed into text that JavaScript reads: a header and arrays.

The packed bytes are: the length of the header (4 bytes, little-endian), the header (JSON in UTF-8),
and the arrays, each at a multiple of 8 bytes. They are compressed (zlib) and written in base64.
"""

from __future__ import annotations

import base64
import json
import sys
import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from masat.arrays import AnyArray, Floats

# Types that JavaScript has typed arrays for, by their names in the header.
_TYPES: dict[str, np.dtype[Any]] = {
    "f4": np.dtype("<f4"),
    "f8": np.dtype("<f8"),
    "i4": np.dtype("<i4"),
    "i8": np.dtype("<i8"),
    "u1": np.dtype("u1"),
    "u2": np.dtype("<u2"),
}
_ALIGNMENT = 8
_LENGTH_BYTES = 4
# Higher levels take several times as long and save 1 %.
_LEVEL = 4


def single(values: Floats) -> NDArray[np.float32]:
    """Return values in single precision; those of maps that diverged may become infinite."""
    with np.errstate(over="ignore"):
        return values.astype(np.float32)


def pack(header: Mapping[str, Any], arrays: Mapping[str, AnyArray]) -> str:
    """Return a header and arrays as base64 text.

    Parameters
    ----------
    header : mapping
        What JSON can hold. Its key "arrays" is added.
    arrays : mapping of str to ndarray
        Arrays of float32, float64, int32, int64, uint8, uint16 or bool, which becomes uint8.

    Returns
    -------
    str
    """
    table: dict[str, Any] = {}
    parts: list[bytes] = []
    offset = 0
    for name, array in arrays.items():
        kind, values = _encoded(array)
        table[name] = {"type": kind, "shape": list(array.shape), "offset": offset}
        size = len(values) + -len(values) % _ALIGNMENT
        parts.append(values.ljust(size, b"\0"))
        offset += size
    text = json.dumps({**header, "arrays": table}, separators=(",", ":"), allow_nan=False)
    encoded = text.encode()
    # Blanks behind the JSON align the arrays.
    encoded += b" " * (-(len(encoded) + _LENGTH_BYTES) % _ALIGNMENT)
    data = len(encoded).to_bytes(_LENGTH_BYTES, "little") + encoded + b"".join(parts)
    return base64.b64encode(zlib.compress(data, _LEVEL)).decode()


def unpack(text: str) -> tuple[dict[str, Any], dict[str, AnyArray]]:
    """Return the header and the arrays that `pack` packed."""
    data = zlib.decompress(base64.b64decode(text))
    begin = _LENGTH_BYTES + int.from_bytes(data[:_LENGTH_BYTES], "little")
    header = json.loads(data[_LENGTH_BYTES:begin])
    arrays = {}
    for name, entry in header.pop("arrays").items():
        count = int(np.prod(entry["shape"]))
        flat = np.frombuffer(data, _TYPES[entry["type"]], count, begin + entry["offset"])
        arrays[name] = flat.reshape(entry["shape"])
    return header, arrays


def _encoded(array: AnyArray) -> tuple[str, bytes]:
    """Return the name of an array's type, and its values, little-endian."""
    if array.dtype == np.bool_:
        array = array.astype(np.uint8)
    kind = f"{array.dtype.kind}{array.dtype.itemsize}"
    values = np.ascontiguousarray(array)
    if sys.byteorder == "big":
        values = values.astype(_TYPES[kind])
    return kind, values.tobytes()
