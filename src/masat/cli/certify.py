"""`masat certify`."""

from __future__ import annotations

from pathlib import Path

import click

from masat.cli import EXIT_NOT_CONVERGED, options, show
from masat.formats import write
from masat.optimality.certificate import Certificate
from masat.optimality.certificate import certify as certified


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
@click.option("--seed", type=int, default=0, show_default=True, help="Of the search.")
@options.threads
@options.output
@click.pass_context
def certify(
    ctx: click.Context,
    file: Path,
    file_format: str | None,
    indefinite: str,
    out: Path | None,
    seed: int,
    threads: int,
    as_json: bool,
    quiet: bool,
) -> None:
    """Tell whether the poses in FILE, from whatever program, are globally optimal.

    Proves it by a bound that no poses' cost lies below, or finds better ones, or says that it is
    open. Exit code 0 if it is proven, else 1.
    """
    options.check_writable(out, file)
    graph = options.load(file, file_format, indefinite, quiet)
    with show.Wait(f"{file.name}  certificate", quiet=quiet):
        proof = certified(graph, seed=seed, threads=threads)
    if out is not None and proof.better is not None:
        write(proof.better, out)
    if as_json:
        show.as_json({"file": str(file), **(show.certificate(proof) or {})})
    elif not quiet:
        _tell(proof, out)
    if not proof.certified:
        ctx.exit(EXIT_NOT_CONVERGED)


def _tell(proof: Certificate, out: Path | None) -> None:
    written = "nothing"
    if proof.better is not None:
        written = str(out) if out is not None else "nothing: name a file with -o for better poses"
    equal = ", which is chi2 here," if proof.exact else ""
    rows = [
        ("certified", "yes" if proof.certified else "no"),
        ("finding", proof.message),
        ("chi2", f"{proof.chi2:.8g} in the file, {proof.optimum:.8g} at the best minimum found"),
        (
            "chordal cost",
            f"{proof.cost:.8g}{equal} at its best minimum found; no poses have less than "
            f"{proof.bound:.8g}: a gap of {proof.gap:.2g}",
        ),
        ("written", written),
    ]
    for key, text in rows:
        click.echo(f"{key:<13} {text}")
