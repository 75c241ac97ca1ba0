"""`masat demo`."""

from __future__ import annotations

from pathlib import Path

import click

from masat.cli import options, show
from masat.cli.compare import run, runs_as_json, show_runs
from masat.worlds import manhattan, perturb

_DRAWN = ("odometry", "spanning_tree", "masat", "auto")


@click.command()
@click.option("--nodes", type=click.IntRange(min=100), default=3500, show_default=True)
@click.option(
    "--noise",
    type=click.FloatRange(min=0),
    default=0.2,
    show_default=True,
    help="Standard deviation of each measured x, y (meters) and heading (radians).",
)
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True)
@click.option(
    "--plot",
    "picture",
    type=click.Path(path_type=Path),
    default=Path("masat_demo.png"),
    show_default=True,
)
@options.output
def demo(nodes: int, noise: float, seed: int, picture: Path, as_json: bool, quiet: bool) -> None:
    """Simulate a robot's walk through Manhattan, solve it from every initial guess, draw four.

    The guess 'given' is the simulated truth, which nobody has in real life.
    """
    options.check_outputs(None, picture)
    options.check_picture(picture)
    truth = manhattan(nodes, int(1.55 * nodes), extent=int(nodes**0.5), seed=seed)
    graph = perturb(truth, (noise, noise, noise), seed=seed)
    found = run(graph, "gauss_newton", quiet=quiet, max_iterations=50, relative_tolerance=1e-6)
    from masat.plotting import plot

    shown = [r for r in found.runs if r.init in _DRAWN]
    plot(
        {f"initial guess: {r.init}": r.guess for r in shown}
        | {f"optimized from {r.init}": r.result.graph for r in shown},
        picture,
        columns=len(shown),
    )
    if as_json:
        show.as_json({"nodes": nodes, "edges": len(graph.edges), "inits": runs_as_json(found)})
    elif not quiet:
        click.echo(
            f"A walk of {nodes} poses with {len(graph.edges)} measurements, noise {noise} m and "
            f"rad, Gauss-Newton with at most 50 iterations:"
        )
        show_runs(found)
        click.echo(f"Picture: {picture}    Next: masat solve FILE -o OUT --plot OUT.png")
