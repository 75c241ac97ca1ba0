"""Reading designs from TOML files."""

from __future__ import annotations

from dataclasses import replace
from importlib import resources
from pathlib import Path

from masat.study.design import Design
from masat.study.design_keys import check_design
from masat.study.names import StudyError
from masat.study.toml_lines import TomlText

# Far above what a design needs: it only catches files that are none.
_MAX_BYTES = 1_000_000


def shipped() -> list[str]:
    """Return the names of the designs that come with the package."""
    folder = resources.files("masat.study") / "designs"
    return sorted(p.name.removesuffix(".toml") for p in folder.iterdir())


def shipped_text(name: str) -> str:
    """Return the TOML text of a design that comes with the package."""
    if name not in shipped():
        raise StudyError(f"no design {name!r} comes with masat; known: {', '.join(shipped())}")
    return (resources.files("masat.study") / "designs" / f"{name}.toml").read_text("utf-8")


def load_design(name: str) -> Design:
    """Read a design by the name of one that comes with the package, or from a file.

    Parameters
    ----------
    name : str
        A name of `shipped()`, or else the path of a TOML file; docs/studies.md describes its keys.

    Raises
    ------
    StudyError
        If the file cannot be read or asks for what cannot be run; names the file and the line.
    """
    if name in shipped():
        text = TomlText(f"{name}.toml", shipped_text(name))
    else:
        text = TomlText(name, _read(Path(name)))
    design = check_design(text.parse(), text)
    return design if design.title else replace(design, title=Path(text.path).stem)


def _read(path: Path) -> str:
    if path.is_dir():
        raise StudyError(f"{path}: is a folder, expected a design in a TOML file")
    if not path.is_file():
        raise StudyError(
            f"{path}: there is no such design; give the path of a TOML file, or one of the designs "
            f"that come with masat: {', '.join(shipped())}"
        )
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise StudyError(f"{path}: has more than {_MAX_BYTES:,} bytes; it is no design")
        data = path.read_bytes()
    except OSError as error:
        raise StudyError(f"{path}: cannot be read: {error.strerror or error}") from None
    encoded = "is not UTF-8 text; save the design as a text file in UTF-8"
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise StudyError(f"{path}:{line}: {encoded}") from None
    if "\0" in text:
        line = text.count("\n", 0, text.index("\0")) + 1
        raise StudyError(f"{path}:{line}: {encoded}")
    return text
