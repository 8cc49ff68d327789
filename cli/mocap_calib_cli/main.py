"""The command `mocap-calib`: a table of commands, imported when they are called, and the one place where errors end.

stdout is data, stderr is talk. Exit status: 0 done, 1 the data or the calibration is bad, 2 usage, 130 interrupted.
"""

import importlib
import os
import sys

import click

from mocap_calib import __version__
from mocap_calib.errors import MocapCalibError
from mocap_calib_cli.mistakes import explained

# name: (module:attribute, what the list of commands says of it); kept here so that the list imports no command
COMMANDS = {
    "run": (
        "mocap_calib_cli.commands.run:command",
        "Keypoints to cameras and 3D poses: all stages in one.",
    ),
    "batch": (
        "mocap_calib_cli.commands.batch:command",
        "Many recordings, here or on a cluster; what is finished is kept.",
    ),
    "inspect": (
        "mocap_calib_cli.commands.inspect:command",
        "What is in keypoint files, and what stands in the way of a run.",
    ),
    "pairwise": (
        "mocap_calib_cli.commands.pairwise:command",
        "Relative positions of all pairs of cameras.",
    ),
    "average": ("mocap_calib_cli.commands.average:command", "Pairs to one rig."),
    "match": ("mocap_calib_cli.commands.match:command", "Who is who in all cameras."),
    "adjust": ("mocap_calib_cli.commands.adjust:command", "Bundle adjustment of the rig."),
    "triangulate": ("mocap_calib_cli.commands.triangulate:command", "3D poses."),
    "convert": (
        "mocap_calib_cli.commands.convert:command",
        "Keypoints, cameras and poses from one format to another.",
    ),
    "complete": (
        "mocap_calib_cli.commands.complete:command",
        "Fill keypoints that were not seen; one set of joints for all cameras.",
    ),
    "evaluate": (
        "mocap_calib_cli.commands.evaluate:command",
        "Compare cameras with a reference calibration.",
    ),
    "simulate": (
        "mocap_calib_cli.commands.simulate:command",
        "Make a synthetic recording with its truth.",
    ),
    "models": ("mocap_calib_cli.commands.models:command", "List the networks that are shipped."),
    "train": ("mocap_calib_cli.commands.train:command", "Train the network that lifts 2D poses."),
}


class LazyGroup(click.Group):
    """Imports a command when it is called (after click's documentation, "Lazily loading subcommands")."""

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002 - click's signature
        """In the order of the table."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:  # noqa: ARG002
        """Imports the command."""
        if cmd_name not in COMMANDS:
            return None
        module, attribute = COMMANDS[cmd_name][0].split(":")
        command: click.Command = getattr(importlib.import_module(module), attribute)
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:  # noqa: ARG002
        """Lists the commands without importing them."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, text) for name, (_, text) in COMMANDS.items()])


@click.group(
    cls=LazyGroup,
    context_settings={
        "help_option_names": ["-h", "--help"],
        "show_default": True,
        "max_content_width": 100,
    },
)
@click.version_option(__version__, prog_name="mocap-calib", message="%(prog)s %(version)s")
def group() -> None:
    """Calibrates cameras from the 2D keypoints of moving people and animals, and triangulates them.

    \b
    Example:
      mocap-calib run keypoints/ --cameras intrinsics.toml -o out
      mocap-calib evaluate out/cameras.yaml --reference reference.toml
    """


def main() -> None:
    """The entry point: runs the command, and turns a user's mistake into one line and an exit status."""
    for library in (
        "OPENBLAS",
        "MKL",
    ):  # read when numpy is imported; sums of theirs depend on the number of threads
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")
    try:
        # without standalone mode click leaves errors to us
        status = group.main(prog_name="mocap-calib", standalone_mode=False)
    except click.ClickException as error:
        error.show()
        status = error.exit_code
    except click.Abort as error:
        if isinstance(error.__cause__, EOFError):  # click takes it for an interruption
            raise
        status = _complain("interrupted", 130)
    except BrokenPipeError:
        sys.stdout = None  # the reader has gone: flushing at exit would complain
        status = 1
    except (MocapCalibError, OSError) as error:
        if not (line := explained(error)):
            raise
        status = _complain(line, 1)
    sys.exit(status or 0)


def _complain(message: str, status: int) -> int:
    click.echo(f"mocap-calib: {message}", err=True)
    return status
