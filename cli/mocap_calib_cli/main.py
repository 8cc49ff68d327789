"""The command `mocap-calib`: the list of its commands, and the one place where errors end.

Results go to stdout, messages to stderr. Exit status: 0 done, 1 the data or the calibration is
bad, 2 usage, 130 interrupted.
"""

import importlib
import os
import sys
from typing import TYPE_CHECKING

import click

from mocap_calib import __version__
from mocap_calib.errors import MocapCalibError, suggest
from mocap_calib_cli.mistakes import explain

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem

# what the list of commands says of each; kept here, so that the list imports none of them
COMMANDS = {
    "run": "Keypoints to cameras and 3D poses: all stages in one.",
    "batch": "Many recordings, here or on a cluster; what is finished is kept.",
    "inspect": "What is in keypoint files, and what would make a run fail.",
    "pairwise": "Relative poses of all pairs of cameras.",
    "average": "Pairs to one rig.",
    "match": "Who is who in all cameras.",
    "adjust": "Bundle adjustment of the rig.",
    "triangulate": "3D poses.",
    "convert": "Keypoints, cameras and poses from one format to another.",
    "complete": "Fill keypoints that were not seen; one set of joints for all cameras.",
    "evaluate": "Compare cameras with a reference calibration.",
    "simulate": "Make a synthetic recording with its truth.",
    "models": "List the networks that are shipped.",
    "train": "Train the network that lifts 2D poses.",
}


class LazyGroup(click.Group):
    """Import a command when it is called (click's documentation: "Lazily loading subcommands")."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names in the order of the list."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import the module of a command, and return the command."""
        if cmd_name not in COMMANDS:
            return None
        module = importlib.import_module(f"mocap_calib_cli.commands.{cmd_name}")
        command: click.Command = module.command
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Return the command that is called. Raises click's UsageError for another word."""
        word = args[0]
        if word not in COMMANDS and not word.startswith("-") and not ctx.resilient_parsing:
            raise click.UsageError(
                f"expected one of the commands {', '.join(COMMANDS)}, found {word}; "
                f"{suggest(word, COMMANDS)}",
                ctx,
            )
        return super().resolve_command(ctx, args)

    def shell_complete(self, ctx: click.Context, incomplete: str) -> "list[CompletionItem]":
        """Offer the commands without importing them, and the options."""
        from click.shell_completion import CompletionItem

        commands = [
            CompletionItem(name, help=text)
            for name, text in COMMANDS.items()
            if name.startswith(incomplete)
        ]
        return [*commands, *click.Command.shell_complete(self, ctx, incomplete)]

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the commands without importing them."""
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))


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
    """Calibrate cameras from the 2D keypoints of moving people and animals, and triangulate them.

    \b
    Example:
      mocap-calib run keypoints/ --cameras intrinsics.toml -o out
      mocap-calib evaluate out/cameras.yaml --reference reference.toml
    """


def main() -> None:
    """Run the command; turn a user's mistake into one line and an exit status."""
    # read when numpy is imported; the sums of these libraries depend on the number of threads
    for library in ("OPENBLAS", "MKL"):
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")
    sys.exit(_run_command())


def _run_command() -> int:
    """Run the command and return the exit status."""
    try:
        # without standalone mode click leaves errors to us
        status = group.main(prog_name="mocap-calib", standalone_mode=False)
    except click.ClickException as error:
        error.show()
        return error.exit_code
    except click.Abort as error:
        if isinstance(error.__cause__, EOFError):  # click takes it for an interruption
            raise
        return _complain("interrupted", 130)
    except BrokenPipeError:
        sys.stdout = None  # the reader has gone: flushing at exit would complain
        return 1
    except (MocapCalibError, OSError) as error:
        if not (line := explain(error)):
            raise
        return _complain(line, 1)
    return status or 0


def _complain(message: str, status: int) -> int:
    """Write a message to stderr, and return the status."""
    click.echo(f"mocap-calib: {message}", err=True)
    return status
