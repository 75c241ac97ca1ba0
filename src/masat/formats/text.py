"""The text of a file, decompressed if it is a gzip file, within a limit of size; its numbers."""

from __future__ import annotations

import errno
import gzip
import io
import math
import os
import re
import stat
import zlib
from pathlib import Path

from masat.errors import FormatError

MAX_BYTES = 2**31
"""Default limit of a text's size: 25 million edges in 2D, 8 million in 3D."""

# What the core reads as a number, too: no underscores, no nan, no inf.
_INTEGER = re.compile(r"[+-]?[0-9]+")
_DECIMAL = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")
_GZIP = b"\x1f\x8b"
_CHUNK = 2**20


def load_text(path: Path, max_bytes: int = MAX_BYTES) -> bytes:
    """Return the contents of a regular file, decompressed if it is a gzip file.

    A gzip file of a few megabytes can expand to gigabytes, so it is decompressed piece by piece,
    and no further than to the limit.

    Parameters
    ----------
    path : Path
        The file.
    max_bytes : int
        Largest size of the decompressed text.

    Returns
    -------
    bytes

    Raises
    ------
    FormatError
        If the path is a pipe or a device, the text is larger than the limit, or the gzip file is
        damaged.
    OSError
        If the file cannot be opened or read.
    """
    _check_regular(path)
    with path.open("rb") as file:
        compressed = file.read(len(_GZIP)) == _GZIP
        file.seek(0)
        if not compressed:
            if os.fstat(file.fileno()).st_size > max_bytes:
                raise _too_large(path, max_bytes)
            return file.read()
        # Its buffer becomes the result without a copy.
        text = io.BytesIO()
        try:
            with gzip.GzipFile(fileobj=file) as content:
                while chunk := content.read(_CHUNK):
                    if text.tell() + len(chunk) > max_bytes:
                        raise _too_large(path, max_bytes)
                    text.write(chunk)
        except (EOFError, OSError, zlib.error) as error:
            raise FormatError(f"a damaged gzip file: {error}", path) from None
        return text.getvalue()


def is_integer(word: str) -> bool:
    """Tell whether a word is an integer of any size."""
    return _INTEGER.fullmatch(word) is not None


def integer_of(word: str) -> int | None:
    """Return the integer of at most 64 bits that a word is, or None."""
    digits = word.lstrip("+-0") or "0"
    # Python refuses to convert thousands of digits.
    if not is_integer(word) or len(digits) > len(str(2**63)):
        return None
    value = -int(digits) if word.startswith("-") else int(digits)
    return value if -(2**63) <= value < 2**63 else None


def number_of(word: str) -> float | None:
    """Return the finite number that a word is, or None."""
    if not _DECIMAL.fullmatch(word):
        return None
    value = float(word)
    return value if math.isfinite(value) else None


def _check_regular(path: Path) -> None:
    """Refuse pipes and devices, which may have no end and can be read only once."""
    try:
        mode = path.stat().st_mode
    except ValueError as error:  # a zero byte, or a character that file names cannot have
        raise FormatError(f"not a valid file name: {error}", path) from None
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not stat.S_ISREG(mode):
        kind = "a pipe" if stat.S_ISFIFO(mode) else "a device or socket"
        raise FormatError(f"{kind}, expected a regular file: save its text to a file first", path)


def _too_large(path: Path, max_bytes: int) -> FormatError:
    return FormatError(
        f"the text is larger than the limit of {max_bytes} bytes; if that is intended, raise the "
        "limit (max_bytes=... in Python, --max-bytes on the command line)",
        path,
    )
