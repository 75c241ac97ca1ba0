"""`masat certify`."""

from __future__ import annotations

from pathlib import Path

import click

from masat.cli import EXIT_NOT_CONVERGED, options, show
from masat.cli.progress import Stages
from masat.errors import MasatError
from masat.formats import format_of, write
from masat.optimality.certificate import Certificate
from masat.optimality.certificate import certify as certified
from masat.progress import Progress


@click.command(
    epilog="Example:  masat certify map-of-another-program.g2o -o better.g2o",
)
@options.graph_file
@click.option(
    "-o",
    "--output",
    "out",
    type=click.Path(path_type=Path),
    help="Where to write better poses, if some are found.",
)
@click.option(
    "--search/--no-search",
    default=True,
    show_default=True,
    help="Whether to search for better poses where there is no proof.",
)
@options.search
@options.threads
@options.output
@click.pass_context
def certify(
    ctx: click.Context,
    file: Path,
    file_format: str | None,
    indefinite: str,
    out: Path | None,
    search: bool,
    seed: int,
    budget: float | None,
    threads: int | None,
    as_json: bool,
    quiet: bool,
) -> None:
    """Tell whether the poses in FILE, from whatever program, are globally optimal.

    Proves that no poses have a lower chi2, or finds some that have, or says that it is undecided
    and how far below the optimum can be.

    Exit code 0 if the poses are proven to be optimal, else 1.
    """
    options.check_outputs(file, out)
    if out is not None:
        format_of(out)
    graph = options.load(file, file_format, indefinite, quiet)
    options.check_stamps(graph, out)
    if graph.poses is None:
        raise MasatError(f"{file}: has no poses to certify; masat solve {file} makes a map")
    with Stages(file.name, quiet=quiet) as stages:
        progress = Progress(budget, stages, catch_interrupts=True)
        certificate = certified(graph, search=search, seed=seed, threads=threads, progress=progress)
    if out is not None and certificate.better is not None:
        write(certificate.better, out)
    if as_json:
        show.as_json({"file": str(file), **certificate.to_dict()})
    elif not quiet:
        _print(certificate, out)
    if not certificate.certified:
        ctx.exit(EXIT_NOT_CONVERGED)


def _print(certificate: Certificate, out: Path | None) -> None:
    written = "nothing"
    if certificate.better is not None:
        written = str(out) if out is not None else "nothing: name a file with -o for better poses"
    show.rows(
        [
            ("status", show.status(certificate)),
            ("finding", certificate.message),
            ("chi2", f"{certificate.chi2:.8g} in the file"),
            ("lowest known", f"{certificate.optimum:.8g}"),
            (
                "lower bound",
                f"{certificate.bound:.8g}: no poses have less; a gap of {certificate.gap:.2g} of "
                "chi2",
            ),
            *([("caution", certificate.caveat)] if certificate.caveat else []),
            ("written", written),
        ]
    )
