"""mocap-calib overlay: what a run found, on its videos."""

from typing import TYPE_CHECKING

import click

from mocap_calib_cli import options, values
from mocap_calib_cli.options import OUTPUT_FOLDER, argument, option
from mocap_calib_cli.typed import Typed, as_command

if TYPE_CHECKING:
    from pathlib import Path

_READING = tuple(
    name
    for name in options.READING
    if name not in ("flipped", "sides", "rotated", "resized", "exchanged")
)


def _check_cameras(
    _: click.Context, __: click.Parameter, videos: "tuple[tuple[str, Path], ...]"
) -> "dict[str, Path]":
    """Return the video of each camera. Raises click's BadParameter for two of one."""
    cameras = [camera for camera, _ in videos]
    for camera in cameras:
        if cameras.count(camera) > 1:
            raise click.BadParameter(f"expected one video a camera, found two of {camera}")
    return dict(videos)


@as_command(
    "overlay",
    argument("results", values.FILE, "OUT"),
    option("--video", values.VIDEO, multiple=True, required=True, callback=_check_cameras),
    OUTPUT_FOLDER,
    option("--frames", values.FRAMES),
    option("--keypoints", values.INPUT, multiple=True, metavar="PATH"),
    *_READING,
    "quiet",
)
def command(typed: Typed) -> None:
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

    video: Video of a camera; once for each camera that is wanted.
    frames: Write pictures (PNG) of these frames, as poses3d.h5 numbers them, not videos.
    keypoints: Keypoints, as `run` took them. [default: the files that the run read]
    """
    from mocap_calib.errors import MismatchError
    from mocap_calib.io.keypoints import read_keypoints
    from mocap_calib.overlay.make import make_overlays
    from mocap_calib.overlay.results import read_results
    from mocap_calib_cli import inputs
    from mocap_calib_cli.screen import Reporter

    with Reporter(quiet=typed.quiet) as reporter:
        found = read_results(typed.results)
        read = inputs.options_of_reading(found.reading, typed)
        if not read.keypoints:
            absent = "run.json to say which keypoints the run read"
            raise MismatchError("", absent, "that it does not", "give --keypoints")
        notes = make_overlays(
            found,
            read_keypoints(read.keypoints, read.format, inputs.read_options(read)),
            typed.video,
            typed.output,
            frames=typed.frames,
            shifts=dict(read.frame_offset),
            mirrored=read.mirrored,
            progress=reporter,
        )
    reporter.say(*notes, f"overlays in {typed.output}")
