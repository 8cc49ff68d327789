"""mocap-calib convert: keypoints, cameras and poses from one format to another."""

import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from mocap_calib_cli import options

if TYPE_CHECKING:
    from mocap_calib.io.conversion import Conversion


@click.command(name="convert")
@click.argument("inputs", nargs=-1, required=True, metavar="INPUT...")
@click.argument("output", metavar="OUTPUT")
@click.option(
    "--from",
    "source",
    metavar="FORMAT",
    help="Format of INPUT, where its content does not show it; needed for stdin.",
)
@click.option(
    "--to",
    "target",
    metavar="FORMAT",
    help="Format of OUTPUT, where the ending of its name does not say it.",
)
@click.option(
    "--unit",
    type=click.Choice(["m", "cm", "mm"]),
    help="What a length of 1 is in INPUT, where the file does not say.",
)
@click.option(
    "--fps",
    type=click.FloatRange(min=0, min_open=True),
    help="Frames per second of poses, where the file does not say.",
)
@click.option(
    "--up",
    type=click.Choice(["x", "y", "z", "-x", "-y", "-z"]),
    help="The axis of INPUT's world that points up: poses are turned so that it is y.",
)
@options.reading_but_format
@options.quiet
def command(
    inputs: tuple[str, ...],
    output: str,
    source: str | None,
    target: str | None,
    unit: str | None,
    fps: float | None,
    up: str | None,
    reading: dict[str, Any],
    quiet: bool,
) -> None:
    """Converts INPUT to OUTPUT: between two formats of keypoints, of cameras, or of 3D poses.

    INPUT is a file or a folder (keypoints: any number, also name=path); - is stdin or stdout.
    What the format of OUTPUT cannot hold is said, or refused. docs/formats.md lists the formats.

    \b
    Example:
      mocap-calib convert calibration.toml model --to colmap
      mocap-calib convert poses3d.h5 poses.trc --unit m --fps 60 --up z
      mocap-calib convert openpose/ keypoints --to coco --layout body_25
      mocap-calib convert - - --from anipose --to nerfstudio <calibration.toml >transforms.json
    """
    from mocap_calib.io import conversion, kinds
    from mocap_calib_cli import outputs
    from mocap_calib_cli.progress import Reporter

    content = _read_stdin(inputs, source)
    if content is None:
        kinds.check_sources(inputs)
    sources = inputs if content is None else content
    kind = kinds.choose_kind(sources, output, format=source, to=target)
    _check_options({"unit": unit, "fps": fps, "up": up, **reading}, kind, reading)
    to = target or kinds.choose_format(kind, output)
    path = None if output == options.STDIO else Path(output)
    if path is not None:
        outputs.check_place(path)

    if kind == "poses":
        paths = [Path(argument) for argument in inputs]
        done = conversion.convert_poses(
            paths if content is None else content,
            path,
            to,
            format=source,
            unit=unit,
            fps=fps,
            up=up,
        )
    elif kind == "cameras":
        done = _convert_cameras(inputs, content, path, to, format=source, unit=unit, given=reading)
    else:
        done = _convert_keypoints(inputs, content, path, to, format=source, given=reading)
    if path is None:
        _write_stdout(done.files, to)
    lost = (f"{to} does not hold {what}" for what in done.lost)
    Reporter(quiet=quiet).say(*done.notes, done.summary, *lost)


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
            f"{format}: expected one file for stdout, found {len(files)} "
            f"({', '.join(list(files)[:4])}); give a folder"
        )
    sys.stdout.buffer.write(next(iter(files.values())))
    sys.stdout.buffer.flush()


def _check_options(given: Mapping[str, Any], kind: str, reading: Mapping[str, Any]) -> None:
    """Raise click's UsageError for an option that says nothing of this kind of file."""
    known = {
        "poses": {"unit", "fps", "up"},
        "cameras": {"unit", "image_size"},
        "keypoints": set(reading),
    }
    for name, value in given.items():
        if value not in (None, ()) and name not in known[kind]:
            raise click.UsageError(
                f"--{name.replace('_', '-')}: expected an option of {kind}, which INPUT holds, "
                "found one of other files; leave it out"
            )


def _convert_cameras(
    inputs: tuple[str, ...],
    content: bytes | None,
    output: Path | None,
    to: str,
    *,
    format: str | None,
    unit: str | None,
    given: Mapping[str, Any],
) -> "Conversion":
    """Convert the cameras of one input. Raises click's UsageError where there are more."""
    from mocap_calib.io.conversion import convert_cameras
    from mocap_calib_cli import inputs as reading_inputs
    from mocap_calib_cli import outputs

    if len(inputs) > 1:
        raise click.UsageError(
            f"expected one file or folder of cameras, found {len(inputs)}; give the folder"
        )
    return convert_cameras(
        Path(inputs[0]) if content is None else content,
        output,
        to,
        format=format,
        unit=unit,
        image_size=reading_inputs.image_size(given.get("image_size")),
        provenance=outputs.provenance("convert", inputs=reading_inputs.hashes(inputs)),
    )


def _convert_keypoints(
    inputs: tuple[str, ...],
    content: bytes | None,
    output: Path | None,
    to: str,
    *,
    format: str | None,
    given: Mapping[str, Any],
) -> "Conversion":
    """Convert keypoints; note also which files of the inputs are left out."""
    from mocap_calib.io.conversion import convert_keypoints
    from mocap_calib_cli import inputs as reading_inputs

    done = convert_keypoints(
        inputs if content is None else content,
        output,
        to,
        format=format,
        options=reading_inputs.read_options(given),
    )
    return replace(done, notes=(*reading_inputs.doubled(inputs), *done.notes))
