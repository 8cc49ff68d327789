"""The command `mocap-calib`: the list of its commands, and the one place where errors end.

Results go to stdout, messages to stderr. Exit status: 0 done, 1 the data or the calibration is
bad, 2 usage, 130 interrupted; docs/cli.md has a table. The list of commands has
these texts:

run: Keypoints to cameras and 3D poses: all stages in one.
batch: Many recordings; what is finished is kept.
inspect: What is in keypoint files, and what would make a run fail.
pairwise: Relative poses of all pairs of cameras.
average: Where all cameras stand, from the pairs (the rig).
match: Find identities across all cameras.
adjust: Make the rig as exact as the keypoints allow (bundle adjustment).
triangulate: 3D poses from the rig and the matches.
scale: Set the scale of results by known lengths.
smooth: Best estimates of 3D poses, from the rig and the matches.
filter: Butterworth, median or Savitzky-Golay filter of 3D poses.
convert: Keypoints, cameras and poses from one format to another.
kinematics: Joint angles, speeds, contacts and bone lengths of 3D poses.
complete: Fill keypoints that were not seen.
overlay: Draw what a run found on its videos.
report: The results of a run to look at, in one HTML file.
verify: Judge an existing calibration by keypoints: which camera moved since?
evaluate: Compare cameras with a reference calibration.
example: Lay out a recording to begin with: people, a dog, a mouse.
simulate: Make a synthetic recording with its truth.
doctor: Look at the machine and the installation, with a self-test.
models: List the networks that are shipped.
train: Train the network that lifts 2D poses.
"""

import io
import os
import sys
from typing import Any

import click

from mocap_calib import __version__
from mocap_calib.compute import BLAS_THREADS
from mocap_calib.errors import MocapCalibError, suggest, visible
from mocap_calib_cli.commands import (
    batch,
    complete,
    convert,
    doctor,
    evaluate,
    example,
    filter,
    inspect,
    kinematics,
    models,
    overlay,
    report,
    run,
    scale,
    simulate,
    stages,
    train,
    verify,
)
from mocap_calib_cli.docstrings import split_help
from mocap_calib_cli.screen import echo
from mocap_calib_cli.typed import explain

_COMMANDS = (
    *(run.command, batch.command, inspect.command, stages.pairwise, stages.average, stages.match),
    *(stages.adjust, stages.triangulate, scale.command, stages.smooth, filter.command),
    *(convert.command, kinematics.command, complete.command, overlay.command, report.command),
    *(verify.command, evaluate.command, example.command, simulate.command, doctor.command),
    *(models.command, train.command),
)


class Group(click.Group):
    """The commands, in the order of their list."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names in the order of the list."""
        return list(self.commands)

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command; what a user can correct ends in a line, and status 1."""
        try:
            return super().invoke(ctx)
        except (MocapCalibError, OSError) as error:
            line = explain(error, self.get_command(ctx, ctx.invoked_subcommand or ""))
            if line is None:
                raise
            ctx.exit(_complain(line, 1))

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Return the command that is called. Raises click's UsageError for another word."""
        word, known = args[0], self.commands
        if word not in known and not word.startswith("-") and not ctx.resilient_parsing:
            raise click.UsageError(
                f"expected one of the commands {', '.join(known)}, found {word}; "
                f"{suggest(word, known)}",
                ctx,
            )
        return super().resolve_command(ctx, args)


_SETTINGS = {"help_option_names": ["-h", "--help"], "show_default": True, "max_content_width": 100}


@click.group(cls=Group, context_settings=_SETTINGS)
@click.version_option(__version__, prog_name="mocap-calib", message="%(prog)s %(version)s")
def group() -> None:
    """Calibrate cameras from the 2D keypoints of moving people and animals, and triangulate them.

    \b
    Example, in the folder examples/three_people:
      mocap-calib inspect keypoints/ --cameras intrinsics.toml
      mocap-calib run keypoints/ --cameras intrinsics.toml -o out
      mocap-calib evaluate out/cameras.yaml --reference reference.toml

    `mocap-calib COMMAND --help` describes a command. The commands from `pairwise` to `triangulate`
    are the stages of `run`, one at a time. docs/completion.md says how the shell completes
    commands, options and names of formats.
    """


for _command in _COMMANDS:
    _command.short_help = split_help(__doc__)[1].get(str(_command.name))
    group.add_command(_command)


def main() -> None:
    """Run the command; turn a user's mistake into one line and an exit status."""
    for variable in BLAS_THREADS:  # the sums of these libraries depend on the number of threads
        os.environ.setdefault(variable, "1")
    _speak_utf8()
    sys.exit(_run_command())


def _speak_utf8() -> None:
    """Make what is written UTF-8 with the same line ends on every system.

    Windows writes to files and pipes in the code page of the country, which lacks most letters.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(encoding="utf-8", errors=stream.errors, newline="\n")


def _run_command() -> int:
    """Run the command and return the exit status.

    Where the reader of stdout has gone, click ends with status 1, in silence.
    """
    try:
        # without standalone mode click leaves errors to us
        status = group.main(prog_name="mocap-calib", standalone_mode=False)
    except click.ClickException as error:
        error.message = visible(error.message, kept="\n\t")  # type: ignore[misc]
        error.show()
        return error.exit_code
    except click.Abort as error:
        if isinstance(error.__cause__, EOFError):  # click takes it for an interruption
            raise
        return _complain("interrupted", 130)
    return status or 0


def _complain(message: str, status: int) -> int:
    """Write a message to stderr, and return the status."""
    echo(f"mocap-calib: {message}", err=True)
    return status
