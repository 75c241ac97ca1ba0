"""The command `masat`: one file a subcommand, loaded when it is called."""

from __future__ import annotations

import importlib
import sys
import warnings

import click

EXIT_NOT_CONVERGED = 1
EXIT_BAD_INPUT = 2
EXIT_INTERRUPTED = 130

# Their help stands here so that `masat --help` loads none of them.
_COMMANDS = {
    "solve": "Optimize a pose graph and write the map.",
    "merge": "Merge the sessions of a robot, or of several, into one map.",
    "view": "Look at a map in the browser: an HTML page that needs no server.",
    "info": "Say what a pose graph is like and what is wrong with it.",
    "compare": "Solve a pose graph from every initial guess and compare.",
    "replay": "Feed a pose graph to a map that grows, pose by pose, and time the steps.",
    "partition": "Cut a pose graph into parts, for maps beyond one machine.",
    "status": "Tell how far the solve of a graph in parts is.",
    "certify": "Tell whether the poses of a file are globally optimal.",
    "evaluate": "Compare a map with the truth: ATE and RPE.",
    "convert": "Convert a pose graph to another format.",
    "study": "Run and report the paper's evaluation, or a study of your own.",
    "simulate": "Simulate a world and write its pose graph.",
    "demo": "Simulate a world, solve it from every initial guess, draw it.",
}


class _Commands(click.Group):
    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(_COMMANDS)

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        if name not in _COMMANDS:
            return None
        command: click.Command = getattr(importlib.import_module(f"masat.cli.{name}"), name)
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl(list(_COMMANDS.items()))


@click.group(
    cls=_Commands,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog="Start with:  masat demo    or:  masat solve graph.g2o -o map.g2o --plot map.png",
)
@click.version_option(package_name="masat")
def cli() -> None:
    """Make maps of pose graphs: the back end of SLAM.

    FILE is a pose graph in the format of g2o, TORO or iSAM, a trajectory in that of TUM or KITTI,
    gzipped or not, or a saved result (.npz). It is recognized by its content.

    Exit codes: 0 done, 1 did not converge (the best result is still written), 2 bad input or usage.
    """


def main() -> None:
    """Run the command line; errors become one line on standard error."""
    from masat.cli.signals import exit_on_termination
    from masat.errors import MasatError, MasatWarning

    exit_on_termination()
    # Notes are printed by the commands themselves.
    warnings.simplefilter("ignore", MasatWarning)
    try:
        code = cli.main(prog_name="masat", standalone_mode=False)
    except click.exceptions.Exit as stop:
        code = stop.exit_code
    except click.ClickException as error:
        error.show()
        code = error.exit_code
    except (click.Abort, KeyboardInterrupt):
        click.echo("masat: interrupted", err=True)
        code = EXIT_INTERRUPTED
    except MasatError as error:
        click.echo(f"masat: {error}", err=True)
        code = EXIT_BAD_INPUT
    except MemoryError:
        click.echo("masat: there is not enough memory for this graph", err=True)
        code = EXIT_BAD_INPUT
    except OSError as error:
        where = f"{error.filename}: " if error.filename is not None else ""
        click.echo(f"masat: {where}{error.strerror or error}", err=True)
        code = EXIT_BAD_INPUT
    sys.exit(code if isinstance(code, int) else 0)
