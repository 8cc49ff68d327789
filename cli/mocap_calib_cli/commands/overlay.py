"""mocap-calib overlay: what a run found, on its videos."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from mocap_calib_cli import options, values

if TYPE_CHECKING:
    from mocap_calib.types import Keypoints2D

_READING = tuple(
    name
    for name in options.READING
    if name not in ("sides", "rotated", "resized", "exchanged", "crop_offset")
)


@click.command(name="overlay")
@click.argument("results", type=click.Path(path_type=Path), metavar="OUT")
@click.option(
    "--video",
    "videos",
    metavar="CAM=FILE",
    multiple=True,
    required=True,
    help="Video of a camera; once for each camera that is wanted.",
)
@options.output_folder("Folder to write; made when missing.")
@click.option(
    "--frames",
    metavar="N,N-N,...",
    help="Write pictures (PNG) of these frames, as poses3d.h5 numbers them, not videos.",
)
@click.option(
    "--keypoints",
    type=values.ANY_PATH,
    multiple=True,
    metavar="PATH",
    help="Keypoints, as `run` took them. [default: the files that the run read]",
)
@options.shared_options(*_READING, "crop_offset", "quiet")
def command(
    shared: options.SharedOptions,
    results: Path,
    videos: tuple[str, ...],
    output: Path,
    frames: str | None,
    keypoints: tuple[str, ...],
) -> None:
    """Draw the results of a run, in the folder OUT, on the frames of its videos.

    Rings are detections, lines and discs the 3D poses as the camera sees them, each individual in
    its colour, and grey what is nobody's; white are the other cameras, light grey is the floor.
    Where rings and discs of a body come apart, the calibration or the detection is wrong.

    A video's frames are numbered from 0; what the run found of clocks is taken into account.
    Keypoints are read as the run read them. One video a camera is written, CAM.mp4, or pictures,
    CAM_000100.png. docs/overlay.md has more.

    \b
    Example:
      mocap-calib overlay out --video cam1=cam1.mp4 --video cam2=cam2.mp4 -o overlay
      mocap-calib overlay out --video cam1=cam1.mp4 --frames 100,200-210 -o pictures
    """
    from mocap_calib.overlay.make import make_overlays
    from mocap_calib.overlay.results import read_results
    from mocap_calib_cli import outputs
    from mocap_calib_cli.progress import Reporter
    from mocap_calib_cli.reading import options_of_reading
    from mocap_calib_cli.texts import read_options

    files = _parse_videos(videos)
    chosen = None if frames is None else _parse_frames(frames)
    outputs.check_folder(output)
    with Reporter(quiet=shared.quiet) as reporter:
        found = read_results(results)
        read = options_of_reading(found.reading, replace(shared, keypoints=keypoints))
        notes = make_overlays(
            found,
            _read_detections(read),
            files,
            output,
            frames=chosen,
            shifts=read_options(read).frame_offset,
            mirrored=read.mirrored,
            progress=reporter,
        )
    reporter.say(*notes, f"overlays in {output}")


def _read_detections(read: options.SharedOptions) -> "tuple[Keypoints2D, ...]":
    """Return the detections of each camera. Raises FormatError and MismatchError."""
    from mocap_calib.errors import MismatchError
    from mocap_calib.io.keypoints.read import read_keypoints
    from mocap_calib_cli.texts import read_options

    if not read.keypoints:
        raise MismatchError(
            "",
            "run.json to say which keypoints the run read",
            "that it does not",
            "give --keypoints",
        )
    return read_keypoints(read.keypoints, read.format, read_options(read))


def _parse_videos(texts: tuple[str, ...]) -> dict[str, Path]:
    """Return the video of each camera. Raises click's BadParameter."""
    videos: dict[str, Path] = {}
    for text in texts:
        camera, mark, path = text.partition("=")
        if not (camera and mark and path):
            raise click.BadParameter(f"expected CAM=FILE, found {text}", param_hint="--video")
        if camera in videos:
            raise click.BadParameter(
                f"expected one video a camera, found two of {camera}", param_hint="--video"
            )
        videos[camera] = Path(path)
    return videos


def _parse_frames(text: str) -> list[int]:
    """Return the frame numbers of `100,200-210`, each once. Raises click's BadParameter."""
    found: list[int] = []
    for part in text.split(","):
        first, mark, last = part.strip().partition("-")
        if (
            not first.isdecimal()
            or (mark and not last.isdecimal())
            or int(last or first) < int(first)
        ):
            raise click.BadParameter(
                f"expected frame numbers, as 100,200-210, found {text}", param_hint="--frames"
            )
        found += range(int(first), int(last or first) + 1)
    return sorted(set(found))
