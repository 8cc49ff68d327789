"""mocap-calib convert: keypoints, cameras and poses from one format to another."""

import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from mocap_calib_cli import options, values
from mocap_calib_cli.numbers import POSITIVE

if TYPE_CHECKING:
    from mocap_calib.io.conversion import Conversion

# that say nothing of other kinds of files
_READING = tuple(name for name in options.READING if name != "format")
_INPUT = values.PathOf("Expected what to convert, then where to write it: INPUT... OUTPUT.")
_OPTIONS_OF = {
    "poses": {"unit", "input_unit", "fps", "up"},
    "cameras": {"unit", "input_unit", "image_size"},
    "keypoints": set(_READING),
}


@dataclass(frozen=True)
class _Task:
    """What to convert, to what.

    content: of stdin, where it is the input. output: None for stdout. source: name of the format
    of the input, where it was said. target: name of the format of the output.
    """

    inputs: tuple[str, ...]
    content: bytes | None
    output: Path | None
    source: str | None
    target: str

    @property
    def sources(self) -> tuple[str, ...] | bytes:
        """The input, as the library takes it."""
        return self.inputs if self.content is None else self.content

    @property
    def path(self) -> Path | bytes:
        """The first file or folder, or the content of stdin."""
        return Path(self.inputs[0]) if self.content is None else self.content


@click.command(name="convert")
@click.argument("inputs", nargs=-1, required=True, type=_INPUT, metavar="INPUT...")
@click.argument("output", type=values.ANY_PATH, metavar="OUTPUT")
@click.option(
    "--from",
    "source",
    metavar="FORMAT",
    shell_complete=values.offer_formats,
    help="Format of INPUT, where its content does not show it; needed for stdin.",
)
@click.option(
    "--to",
    "target",
    metavar="FORMAT",
    shell_complete=values.offer_written_formats,
    help="Format of OUTPUT, where the ending of its name does not say it.",
)
@click.option(
    "--unit",
    type=click.Choice(["m", "cm", "mm"]),
    help="Unit of the lengths in OUTPUT; those of INPUT must be known.",
)
@click.option(
    "--input-unit",
    type=click.Choice(["m", "cm", "mm"]),
    help="What a length of 1 is in INPUT, where a file of another program does not say.",
)
@click.option(
    "--fps",
    type=POSITIVE,
    help="Frames per second of poses, where the file does not say.",
)
@click.option(
    "--up",
    type=click.Choice(["x", "y", "z", "-x", "-y", "-z"]),
    help="The axis of INPUT's world that points up: poses are turned so that it is y.",
)
@options.shared_options(*_READING, "quiet")
def command(
    shared: options.SharedOptions,
    inputs: tuple[str, ...],
    output: str,
    source: str | None,
    target: str | None,
    unit: str | None,
    input_unit: str | None,
    fps: float | None,
    up: str | None,
) -> None:
    """Convert INPUT to OUTPUT: between two formats of keypoints, of cameras, or of 3D poses.

    INPUT is a file or a folder (keypoints: any number, also name=path); - is stdin or stdout.
    What the format of OUTPUT cannot hold is named, or the conversion is refused. docs/formats.md
    lists the formats. OpenPose's files need --layout, since they do not name their keypoints.
    Formats in metres or millimetres (TRC, C3D, ...) need a known length: see `scale`.

    \b
    Example, in the folder examples/three_people:
      mocap-calib convert out/calibration.toml model --to colmap
      mocap-calib convert out/poses3d.h5 poses.npz
      mocap-calib convert keypoints/ openpose --to openpose
      mocap-calib convert openpose/ again --to csv --layout coco_17
      mocap-calib convert - - --from anipose --to nerfstudio <out/calibration.toml >nerf.json
    """
    from mocap_calib.errors import describe_lost
    from mocap_calib.io import kinds
    from mocap_calib_cli import outputs
    from mocap_calib_cli.progress import Reporter

    content = _read_stdin(inputs, source)
    if content is None:
        kinds.check_sources(inputs)
    sources = inputs if content is None else content
    kind = kinds.choose_kind(sources, output, format=source, to=target)
    own = {"unit": unit, "input_unit": input_unit, "fps": fps, "up": up}
    _check_options(shared, own, kind)
    target = target or kinds.choose_format(kind, output)
    path = None if output == options.STDIO else Path(output)
    if path is not None:
        outputs.check_place(path)
    task = _Task(inputs, content, path, source, target)

    if kind == "poses":
        done = _convert_poses(task, unit=unit, input_unit=input_unit, fps=fps, up=up)
    elif kind == "cameras":
        done = _convert_cameras(
            task, unit=unit, input_unit=input_unit, image_size=shared.image_size
        )
    else:
        done = _convert_keypoints(task, shared)
    if path is None:
        _write_stdout(done.files, target)
    Reporter(quiet=shared.quiet).say(*done.notes, done.summary, *describe_lost(target, done.lost))


# --- the three kinds of files


def _convert_poses(
    task: _Task, *, unit: str | None, input_unit: str | None, fps: float | None, up: str | None
) -> "Conversion":
    """Convert 3D poses of one file, or of a file for each individual."""
    from mocap_calib.io.conversion import convert_poses

    paths = [Path(argument) for argument in task.inputs]
    return convert_poses(
        paths if task.content is None else task.content,
        task.output,
        task.target,
        format=task.source,
        unit=unit,
        input_unit=input_unit,
        fps=fps,
        up=up,
    )


def _convert_cameras(
    task: _Task, *, unit: str | None, input_unit: str | None, image_size: tuple[str, ...]
) -> "Conversion":
    """Convert the cameras of one input. Raises click's UsageError where there are more."""
    from mocap_calib.io.conversion import convert_cameras
    from mocap_calib.io.hashing import hash_inputs
    from mocap_calib.io.provenance import provenance
    from mocap_calib_cli.texts import parse_image_sizes

    if len(task.inputs) > 1:
        raise click.UsageError(
            f"expected one file or folder of cameras, found {len(task.inputs)}; give the folder"
        )
    size_of_all, sizes = parse_image_sizes(image_size)
    if sizes:
        raise click.UsageError(
            f"--image-size: expected one size for all cameras, found that of {min(sizes)}; "
            "say WIDTHxHEIGHT"
        )
    return convert_cameras(
        task.path,
        task.output,
        task.target,
        format=task.source,
        unit=unit,
        input_unit=input_unit,
        image_size=size_of_all,
        provenance=provenance("convert", inputs=hash_inputs(task.inputs)),
    )


def _convert_keypoints(task: _Task, shared: options.SharedOptions) -> "Conversion":
    """Convert keypoints; note also which files of the inputs are left out."""
    from mocap_calib.io.conversion import convert_keypoints
    from mocap_calib.job.load import find_ignored_files
    from mocap_calib_cli.describe import describe_ignored_files
    from mocap_calib_cli.texts import read_options

    done = convert_keypoints(
        task.sources,
        task.output,
        task.target,
        format=task.source,
        options=read_options(shared),
    )
    ignored = describe_ignored_files(find_ignored_files(task.inputs))
    return replace(done, notes=(*ignored, *done.notes))


# --- what was typed


def _check_options(shared: options.SharedOptions, own: Mapping[str, object], kind: str) -> None:
    """Raise click's UsageError for an option that says nothing of this kind of file.

    own: the options of this command alone, by name.
    """
    typed = {**own, **{name: getattr(shared, name) for name in _READING}}
    for name, value in typed.items():
        if value not in (None, ()) and name not in _OPTIONS_OF[kind]:
            raise click.UsageError(
                f"--{name.replace('_', '-')}: expected an option of {kind}, which INPUT holds, "
                "found one of other files; leave it out"
            )


def _read_stdin(inputs: tuple[str, ...], format: str | None) -> bytes | None:
    """Return the content of stdin where it is the input. Raises click's UsageError."""
    if options.STDIO not in inputs:
        return None
    if format is None or len(inputs) > 1:
        raise click.UsageError("stdin: expected it alone, and the name of its format with --from")
    return sys.stdin.buffer.read()


def _write_stdout(files: Mapping[str, bytes], format: str) -> None:
    """Write the file to stdout. Raises MismatchError where it is not one."""
    from mocap_calib.errors import MismatchError

    if len(files) != 1:
        raise MismatchError(
            format,
            "one file for stdout",
            f"{len(files)} ({', '.join(list(files)[:4])})",
            "give a folder",
        )
    sys.stdout.buffer.write(next(iter(files.values())))
    sys.stdout.buffer.flush()
