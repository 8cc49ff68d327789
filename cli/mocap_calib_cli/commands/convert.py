"""mocap-calib convert: keypoints, cameras and poses from one format to another."""

import sys
from collections.abc import Mapping
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from mocap_calib_cli import names, options, values
from mocap_calib_cli.options import RATE_OF_POSES, argument, option
from mocap_calib_cli.outputs import STDIO
from mocap_calib_cli.typed import Typed, as_command

if TYPE_CHECKING:
    from mocap_calib.io.conversion import Conversion
    from mocap_calib.io.kinds import Sources

# that say nothing of other kinds of files
_READING = tuple(name for name in options.READING if name != "format")
_UNITS = ("m", "cm", "mm")
_OPTIONS_OF = {
    "poses": ("unit", "input_unit", "fps", "up"),
    "cameras": ("unit", "input_unit", "image_size"),
    "keypoints": _READING,
}


@as_command(
    "convert",
    argument("inputs", values.INPUT, "INPUT...", several=True),
    argument("output", values.INPUT),
    option("--from format", names.FORMAT),
    option("--to", names.WRITTEN_FORMAT),
    option("--unit", _UNITS),
    option("--input-unit", _UNITS),
    RATE_OF_POSES,
    option("--up", ("x", "y", "z", "-x", "-y", "-z")),
    *_READING,
    "quiet",
)
def command(typed: Typed) -> None:
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

    inputs: What to convert, then where to write it: INPUT... OUTPUT.
    format: Format of INPUT, where its content does not show it; needed for stdin.
    to: Format of OUTPUT, where the ending of its name does not say it.
    unit: Unit of the lengths in OUTPUT; those of INPUT must be known.
    input_unit: What a length of 1 is in INPUT, where a file of another program does not say.
    fps: Frames per second of poses, where the file does not say.
    up: The axis of INPUT's world that points up: poses are turned so that it is y.
    """
    from mocap_calib.errors import describe_lost
    from mocap_calib.io import kinds
    from mocap_calib_cli import outputs
    from mocap_calib_cli.screen import Reporter

    sources = _find_sources(typed)
    kind = kinds.choose_kind(sources, typed.output, format=typed.format, to=typed.to)
    target = typed.to or kinds.choose_format(kind, typed.output)
    path = None if typed.output == STDIO else Path(typed.output)
    own = _options_of(kind, typed)
    if path is not None:
        outputs.check_place(path)
    done = _convert(kind, sources, path, target, typed.format, own)
    if path is None:
        _write_stdout(done.files, target)
    Reporter(quiet=typed.quiet).say(*done.notes, done.summary, *describe_lost(target, done.lost))


def _convert(
    kind: str,
    sources: "Sources",
    output: Path | None,
    target: str,
    format: str | None,
    own: dict[str, Any],
) -> "Conversion":
    """Convert files of a kind with its own options.

    Raises click's UsageError for cameras in several files, or of several sizes.
    """
    from mocap_calib.io.conversion import convert_cameras, convert_keypoints, convert_poses

    given = sources if isinstance(sources, bytes) else [*map(Path, sources)]
    names = [] if isinstance(sources, bytes) else [*map(str, sources)]
    if kind == "poses":
        return convert_poses(given, output, target, format=format, **own)
    if kind == "keypoints":
        from mocap_calib.job.load import find_ignored_files
        from mocap_calib_cli.describe import describe_ignored_files
        from mocap_calib_cli.inputs import read_options

        reading = read_options(Typed(own))
        done = convert_keypoints(sources, output, target, format=format, options=reading)
        ignored = describe_ignored_files(find_ignored_files(names))
        return replace(done, notes=(*ignored, *done.notes))
    from mocap_calib.io.hashing import hash_inputs
    from mocap_calib.io.provenance import provenance

    if len(names) > 1:
        raise click.UsageError(
            f"expected one file or folder of cameras, found {len(names)}; give the folder"
        )
    sizes = dict(own.pop("image_size"))
    own["image_size"] = sizes.pop("", (0, 0))
    for camera in sizes:
        raise click.UsageError(
            f"--image-size: expected one size for all cameras, found that of {camera}; "
            "say WIDTHxHEIGHT"
        )
    made_from = provenance("convert", inputs=hash_inputs(names))
    source = given if isinstance(given, bytes) else given[0]
    return convert_cameras(source, output, target, format=format, provenance=made_from, **own)


# --- what was typed


def _options_of(kind: str, typed: Typed) -> dict[str, Any]:
    """Return the options of a kind of files.

    Raises click's UsageError where one was typed that says nothing of this kind.
    """
    own = _OPTIONS_OF[kind]
    for name in {*chain(*_OPTIONS_OF.values())} - {*own}:
        if name in typed.texts:
            raise click.UsageError(
                f"--{name.replace('_', '-')}: expected an option of {kind}, which INPUT holds, "
                "found one of other files; leave it out"
            )
    return {name: getattr(typed, name) for name in own}


def _find_sources(typed: Typed) -> "Sources":
    """Return the inputs, or the content of stdin. Raises click's UsageError and MismatchError."""
    from mocap_calib.io.kinds import check_sources

    if STDIO not in typed.inputs:
        check_sources(typed.inputs)
        return typed.inputs
    if typed.format is None or len(typed.inputs) > 1:
        raise click.UsageError("stdin: expected it alone, and the name of its format with --from")
    return sys.stdin.buffer.read()


def _write_stdout(files: Mapping[str, bytes], format: str) -> None:
    """Write the file to stdout. Raises MismatchError where it is not one."""
    from mocap_calib.errors import MismatchError

    if len(files) != 1:
        found = f"{len(files)} ({', '.join(list(files)[:4])})"
        raise MismatchError(format, "one file for stdout", found, "give a folder")
    click.echo(next(iter(files.values())), nl=False)
