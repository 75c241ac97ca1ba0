"""Writing of files that appear complete or not at all."""

from __future__ import annotations

import errno
import os
import secrets
import zipfile
import zlib
from pathlib import Path

DAMAGED = (
    KeyError,
    TypeError,
    ValueError,
    EOFError,
    NotImplementedError,
    zlib.error,
    zipfile.BadZipFile,
)
"""What NumPy raises where an .npz file is damaged."""


def write_atomically(path: Path, data: bytes) -> None:
    """Write to a temporary file beside `path`, then rename it to `path`.

    A crash, a full disk or an interrupt leaves `path` as it was. A target that is not a regular
    file (a pipe, a terminal) is written to directly. A symbolic link stays, and the file it points
    to is replaced.

    Parameters
    ----------
    path : Path
        The file; its folder must exist.
    data : bytes
        The new contents.

    Raises
    ------
    OSError
        If the file cannot be written; `filename` is `path`.
    """
    try:
        _write(resolve_target(path), data)
    except OSError as error:
        # The system names the temporary file, or no file at all.
        if error.errno is not None:
            error.filename, error.filename2 = str(path), None
        raise


def resolve_target(path: Path) -> Path:
    """Return the file that a path leads to; a loop of symbolic links is an OSError."""
    try:
        target = path.resolve()
    except RuntimeError:  # a loop, up to Python 3.12
        target = path
    except ValueError as error:  # a zero byte, or a character that file names cannot have
        raise OSError(errno.EINVAL, f"not a valid file name: {error}", str(path)) from None
    if target.is_symlink():
        raise OSError(errno.ELOOP, os.strerror(errno.ELOOP), str(path))
    return target


def _write(target: Path, data: bytes) -> None:
    if target.exists() and not target.is_file():
        target.write_bytes(data)
        return
    # Short enough for any name that the target itself may have.
    partial = target.with_name(f".{target.name[:50]}.{secrets.token_hex(4)}.part")
    try:
        with partial.open("xb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        if target.exists():
            partial.chmod(target.stat().st_mode & 0o777)
        partial.replace(target)
    finally:
        partial.unlink(missing_ok=True)
