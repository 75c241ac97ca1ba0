"""Arguments and options that commands share, and the checks of output files."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, TypeVar

import click

from masat.errors import MasatError
from masat.files import resolve_target
from masat.formats import FORMATS, check_needs, format_of, read
from masat.formats.text import MAX_BYTES
from masat.graph import PoseGraph
from masat.initializers import INITIALIZERS
from masat.optimizers import LOSSES, Result

F = TypeVar("F", bound=Callable[..., Any])

OPTIMIZERS = ("lm", "gn", "dogleg")
_PICTURES = (".png", ".pdf", ".svg", ".jpg")

_ZIP = b"PK\x03\x04"  # how the .npz files of results begin
_MAX_BYTES = "masat.max_bytes"  # key of the context's notes


def _set_max_bytes(context: click.Context, parameter: click.Parameter, value: int) -> None:
    """Keep the limit for `load`, so that no command has to pass it on."""
    context.meta[_MAX_BYTES] = value


def graph_file(command: F) -> F:
    """Add FILE and how to read it, for `load`."""
    return reading(click.argument("file", type=click.Path(path_type=Path))(command))


def reading(command: F) -> F:
    """Add how to read FILE, for `load`."""
    for option in (
        click.option(
            "--indefinite",
            type=click.Choice(["error", "nearest", "identity"]),
            default="error",
            show_default=True,
            help="If information matrices are not positive semidefinite: refuse, take the nearest "
            "that are definite, or give every edge the identity.",
        ),
        click.option(
            "--format",
            "file_format",
            type=click.Choice(list(FORMATS)),
            help="Format of FILE, where its tags leave it open (EDGE2: iSAM's or TORO's).",
        ),
        click.option(
            "--max-bytes",
            type=click.IntRange(min=1),
            default=MAX_BYTES,
            show_default=True,
            expose_value=False,
            callback=_set_max_bytes,
            help="Largest size of FILE's text, decompressed.",
        ),
    ):
        command = option(command)
    return command


def load(file: Path, file_format: str | None, indefinite: Any, quiet: bool) -> PoseGraph:
    """Read FILE, a graph or a saved result, and print its notes."""
    loaded = load_any(file, file_format, indefinite, quiet)
    return loaded.graph if isinstance(loaded, Result) else loaded


def load_any(
    file: Path, file_format: str | None, indefinite: Any, quiet: bool
) -> PoseGraph | Result:
    """Read FILE as what it is, a graph or a saved result, and print its notes."""
    loaded: PoseGraph | Result
    max_bytes = click.get_current_context().meta.get(_MAX_BYTES, MAX_BYTES)
    if file_format is None and is_saved_result(file):
        loaded = Result.load(file)
    else:
        loaded = read(file, format=file_format, indefinite=indefinite, max_bytes=max_bytes)
    if not quiet:
        notes(loaded.graph.notes if isinstance(loaded, Result) else loaded.notes)
    return loaded


def is_saved_result(file: Path) -> bool:
    """Tell whether a file is a saved result."""
    if not file.is_file():
        return False
    with file.open("rb") as content:
        return content.read(len(_ZIP)) == _ZIP


def check_stamps(graph: PoseGraph, *targets: Path | None) -> None:
    """Refuse, before the work begins, files whose format needs stamps that the graph lacks."""
    for target in targets:
        if target is not None:
            check_needs(graph, target, FORMATS[format_of(target)], ("stamps",))


def check_rejected(target: Path | None) -> None:
    """Refuse a file of rejected measurements whose format has no place for edges."""
    if target is not None and "poses" in FORMATS[format_of(target)].needs:
        raise MasatError(
            f"{target}: a trajectory holds no rejected measurements; name a file that ends in .g2o"
        )


def notes(texts: Iterable[str]) -> None:
    """Print remarks on standard error."""
    for text in texts:
        click.echo(f"note: {text}", err=True)


def output(command: F) -> F:
    """Add --json and --quiet."""
    command = click.option("-q", "--quiet", is_flag=True, help="Print only errors.")(command)
    return click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")(command)


def initial_guess(command: F) -> F:
    """Add --init and --root."""
    command = click.option(
        "--root",
        type=int,
        help="Id of the node that is placed at the origin and not optimized.  "
        "[default: the smallest id]",
    )(command)
    return click.option(
        "--init",
        type=click.Choice(list(INITIALIZERS)),
        default="auto",
        show_default=True,
        help="Initial guess: 'auto' searches for the lowest minimum; 'given' takes the poses of "
        "FILE; docs/initial_guesses.md compares them all.",
    )(command)


def search(command: F) -> F:
    """Add --seed and --budget."""
    command = click.option(
        "--budget",
        type=click.FloatRange(min=0),
        metavar="SECONDS",
        help="Stop after so many seconds with the best map so far. Ctrl-C does the same.",
    )(command)
    return click.option(
        "--seed",
        type=click.IntRange(min=0),
        default=0,
        show_default=True,
        help="Seed of the random numbers of the search.",
    )(command)


def robust_loss(command: F) -> F:
    """Add --loss and --loss-scale."""
    command = click.option(
        "--loss-scale",
        type=click.FloatRange(min=0, min_open=True),
        metavar="SIGMAS",
        help="Scale of the loss: an edge is doubtful beyond chi2 = SIGMAS^2.  "
        "[default: 3.37 in 2D, 4.1 in 3D]",
    )(command)
    return click.option(
        "--loss",
        type=click.Choice(list(LOSSES)),
        help="Minimize a robust cost, in which wrong edges have little weight; docs/robust.md "
        "compares the losses.  [default: chi2]",
    )(command)


def threads(command: F) -> F:
    """Add --threads."""
    return click.option(
        "--threads",
        type=click.IntRange(min=1, max=1024),
        help="Threads that compute; the numbers do not depend on it.  "
        "[default: as many as pay for this graph; in a folder of parts one]",
    )(command)


def optimizer(command: F) -> F:
    """Add --optimizer, --max-iterations, --tolerance and --threads."""
    for option in (
        threads,
        click.option(
            "--tolerance",
            type=click.FloatRange(min=0),
            default=1e-9,
            show_default=True,
            help="Stop when chi2 falls by a smaller fraction of itself.",
        ),
        click.option(
            "--max-iterations", type=click.IntRange(min=0), default=100, show_default=True
        ),
        click.option(
            "--optimizer",
            type=click.Choice(OPTIMIZERS),
            default="lm",
            show_default=True,
            help="Levenberg-Marquardt, Gauss-Newton or Powell's dogleg.",
        ),
    ):
        command = option(command)
    return command


def check_outputs(source: Path | None, *targets: Path | None) -> None:
    """Refuse, before the work begins, output files that cannot or must not be written.

    Raises
    ------
    MasatError
        If a file is the input, is named twice, is a folder, or its folder does not exist.
    """
    seen: set[Path] = set()
    for target in targets:
        if target is None:
            continue
        resolved = resolve_target(target)  # refuses a loop of symbolic links
        if source is not None and source.exists() and target.exists() and target.samefile(source):
            raise MasatError(f"{target}: is the input, which is never changed; choose another name")
        if resolved in seen:
            raise MasatError(f"{target}: is named for two outputs; choose different names")
        seen.add(resolved)
        if not target.parent.is_dir():
            raise MasatError(f"{target}: its folder does not exist")
        if target.is_dir():
            raise MasatError(f"{target}: is a folder, expected the name of a file")


def check_picture(target: Path | None) -> None:
    """Refuse a picture whose suffix names no format."""
    if target is not None and target.suffix not in _PICTURES:
        raise MasatError(f"{target}: a picture ends in {', '.join(_PICTURES)}")
