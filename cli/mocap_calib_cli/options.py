"""The options that several commands share, each written once; their names are those of Python."""

from collections.abc import Mapping
from typing import Any

import click

from mocap_calib.config import (
    MENDING,
    PAIR_CHOICES,
    PAIR_SOLVERS,
    REFINEMENTS,
    SMOOTH_MODES,
    SYNC_MODES,
    PosesConfig,
    SyncConfig,
    ViewGraphConfig,
    WorldConfig,
)
from mocap_calib_cli import names, numbers, values

STDIO = "-"

# how keypoint files are to be read where they do not say it themselves, and what is wrong there
READING = (
    *("format", "layout", "image_size", "camera_regex", "frame_offset", "crop_offset", "views"),
    *("mirrored", "sides", "rotated", "resized", "exchanged"),
)
KEYPOINTS = ("keypoints", *READING)
MODEL = ("skeleton", "model", "device")
VERDICT = ("strict", "accept")
SCALE = ("height", "length", "camera_distance")
# how a recording is calibrated, and what is written of it
CALIBRATION = (
    *("refine", "focal_uncertainty", "focal_per_camera"),
    *MODEL,
    *("individuals", "pairs", "solver", "seed", "scheduler"),
    *READING,
    *("moved", "mend", "sync", "sync_window", "world", *SCALE, "forward", "align", "smooth"),
    *("write", "fps", "report", *VERDICT, "quiet"),
)


def _check_rates(
    _: click.Context, __: click.Parameter, rates: tuple[tuple[str, float], ...]
) -> dict[str, float]:
    """Return the frames per second of each camera, those of all as that of "".

    Raises click's BadParameter where single ones are typed, and not that of the others.
    """
    found = dict(rates)
    if found and "" not in found:
        typed = ", ".join(f"{camera}:{rate:g}" for camera, rate in found.items())
        raise click.BadParameter(
            f"expected that of the other cameras too, as --fps 30, found {typed} alone"
        )
    return found


def _several(flag: str, kind: click.ParamType[Any], help: str, **more: Any) -> click.Option:
    """Return an option that may be repeated."""
    return click.Option([flag], type=kind, multiple=True, help=help, **more)


def _choice(flag: str, choices: tuple[str, ...], default: str, help: str) -> click.Option:
    """Return an option that is one of a few words."""
    return click.Option([flag], type=click.Choice(choices), default=default, help=help)


_ALL: tuple[click.Parameter, ...] = (
    click.Argument(
        ["keypoints"], nargs=-1, required=True, type=values.KEYPOINTS, metavar="KEYPOINTS..."
    ),
    click.Option(
        ["--format"],
        type=names.KEYPOINT_FORMAT,
        help="Format of the keypoint files, where their content does not show it "
        "(docs/formats.md).",
    ),
    click.Option(
        ["--layout"],
        type=names.LAYOUT,
        help="Names of the keypoints in files that do not name them: body_25, body_25b, coco_17, "
        "... or a,b,c.",
    ),
    _several(
        "--image-size",
        values.IMAGE_SIZE,
        "Size of the images in pixels, where the files do not say it, of all cameras or of "
        "one; positions from 0 to 1 are multiplied by it.",
    ),
    click.Option(
        ["--camera-regex"],
        type=values.PATTERN,
        help="Finds the camera's name in a path: its group `camera`, its first group, or all of "
        "it.",
    ),
    _several(
        "--frame-offset",
        values.FRAME_OFFSET,
        "Added to the frame numbers of a camera; may be given for each camera.",
    ),
    _several(
        "--crop-offset",
        values.CROP_OFFSET,
        "Corner of the part of the image in which a camera's keypoints were found.",
    ),
    click.Option(
        ["--views"],
        type=values.VIEWS,
        help="Views in one file: endings of keypoint names (paw_A, paw_B), each a camera.",
    ),
    _several("--mirrored", values.CAMERA, "The video of this camera is mirrored, left for right."),
    _several(
        "--sides",
        values.CAMERA,
        "Left and right are exchanged in the names of this camera's keypoints.",
    ),
    _several(
        "--rotated",
        values.ROTATED,
        "The images of a camera are turned clockwise against its intrinsics, by 90, 180 or "
        "270 degrees.",
    ),
    _several(
        "--resized",
        values.RESIZED,
        "The images of a camera are so many times as large as its intrinsics say.",
    ),
    _several("--exchanged", values.EXCHANGED, "The intrinsics of these two cameras are exchanged."),
    _several("--moved", values.MOVED, "A camera stands, or looks, elsewhere from this frame on."),
    _choice(
        "--mend",
        MENDING,
        MENDING[0],
        "What is done where the files of a camera turn out to be wrong: auto mends for this "
        "run what has one right way, none only names it.",
    ),
    click.Option(
        ["--cameras"],
        required=True,
        type=values.INTRINSICS,
        metavar="INTRINSICS",
        help="File or folder with the cameras' intrinsics, in any format of docs/formats.md; "
        "- reads stdin.",
    ),
    click.Option(
        ["--refine"],
        type=click.Choice(REFINEMENTS),
        metavar="WHAT",
        help="What of the intrinsics is estimated with the rig: none, focal (length), or focal+k1 "
        "(and the first coefficient of the lens). [default: none, without --cameras focal+k1]",
    ),
    click.Option(
        ["--focal-uncertainty"],
        type=values.PERCENTAGE,
        help="How good the focal lengths in INTRINSICS are, as 5%; they are estimated within it. "
        "[default: 50%]",
    ),
    click.Option(
        ["--focal-per-camera"],
        is_flag=True,
        help="Estimate the intrinsics of each camera by itself. [default: cameras of equal image "
        "size change alike]",
    ),
    click.Option(
        ["--rig"],
        required=True,
        type=values.RIG,
        metavar="CAMERAS",
        help="File or folder with cameras and where they stand (docs/formats.md); - reads stdin.",
    ),
    click.Option(
        ["--matches"],
        required=True,
        type=values.MATCHES,
        metavar="MATCHES",
        help="File of the command `match`; - reads stdin.",
    ),
    click.Option(
        ["--skeleton"],
        type=values.FILE,
        metavar="FILE.yaml",
        help="Your names of joints: a mapping `aliases`, your name: joint.",
    ),
    click.Option(
        ["--model"],
        type=names.MODEL,
        help="Network: shipped (see `models`) or one of your own; none: geometry alone. "
        "[default: by joint names]",
    ),
    _choice("--device", ("cpu", "cuda"), "cpu", "Where the network computes."),
    click.Option(
        ["--individuals"],
        type=numbers.COUNT,
        metavar="N",
        help="How many individuals there are, where you know it: never more get a name, and those "
        "best supported do. [default: as many as the recording needs]",
    ),
    _choice(
        "--pairs",
        PAIR_CHOICES,
        ViewGraphConfig.pairs,
        f"Which pairs of more than {ViewGraphConfig().small_rig} cameras are calibrated: those "
        "chosen by what they see in common, or all, which takes longer. Of fewer cameras, all are.",
    ),
    click.Option(
        ["--solver"],
        type=click.Choice(PAIR_SOLVERS),
        default=PAIR_SOLVERS[0],
        metavar="NAME",
        help="How pairs of cameras are calibrated: search (ours), paper (its gradient descent, "
        "slow; through its own network with --model people_token), or five-point (its baseline).",
    ),
    click.Option(
        ["--seed"], type=numbers.SEED, default=0, help="The same seed gives the same results."
    ),
    click.Option(
        ["--scheduler"],
        metavar="ADDRESS",
        help="Dask scheduler whose workers do the work (tcp://HOST:PORT); same results.",
    ),
    _choice(
        "--sync",
        SYNC_MODES,
        SyncConfig.mode,
        "What is done where the clocks of cameras differ: auto puts them on one clock for "
        "this run, check only says so, off does not look.",
    ),
    click.Option(
        ["--sync-window"],
        type=click.IntRange(min=1),
        default=SyncConfig.window,
        metavar="FRAMES",
        help="By how much a camera may be early or late.",
    ),
    click.Option(
        ["--world"],
        type=names.WORLD,
        default=WorldConfig.axes,
        help="Coordinates of the results: floor (z up, the origin on it), first-camera, the name "
        "of a camera, or a FILE with cameras in a world of yours; auto: the floor where subjects "
        "show it, else the first camera.",
    ),
    _several(
        "--height",
        values.HEIGHT,
        "Stature of who stands, or of one individual (0=1.75); 1.75+-0.01 with a standard "
        "deviation; may be repeated. Known lengths make the unit metres.",
    ),
    _several(
        "--length",
        values.LENGTH,
        "Distance of two joints, as left_hip-left_knee=0.42+-0.01; may be repeated.",
    ),
    _several(
        "--camera-distance",
        values.CAMERA_DISTANCE,
        "Distance of two cameras, as cam1-cam2=3.1+-0.02; may be repeated.",
    ),
    click.Option(
        ["--forward"],
        default="",
        show_default=False,
        metavar="A-B",
        help="What is ahead (y) on the floor: mostly from joint A to joint B. [default: as the "
        "first camera looks]",
    ),
    click.Option(
        ["--align"],
        type=values.FILE,
        metavar="LANDMARKS.csv",
        help="Points of the scene whose places are known, and where cameras see them: columns "
        "name,x,y,z,camera,u,v, metres and pixels. Results are in their coordinates.",
    ),
    _choice(
        "--smooth",
        SMOOTH_MODES,
        PosesConfig.smooth,
        "What is done to the poses: auto fits them to motion and bones as strongly as "
        "held-out detections say, bones to bones alone, off leaves the triangulated points.",
    ),
    _several(
        "--write",
        names.RESULT_FORMAT,
        "Write this format too (colmap, movement-3d, ...: docs/formats.md); may be repeated. "
        "Those in metres need a known length: --height, --length, --camera-distance.",
    ),
    _several(
        "--fps",
        values.RATE,
        "Frames per second, for the formats that need it and for report.html; and of a single "
        "camera whose rate is another.",
        callback=_check_rates,
    ),
    click.Option(
        ["--report/--no-report"],
        default=True,
        help="Write report.html, which shows the results in a browser.",
    ),
    click.Option(["--strict"], is_flag=True, help="Exit status 1 where the rig is weak, too."),
    click.Option(
        ["--accept"],
        type=click.Choice(["not-determined"]),
        help="Exit status 0 also where the rig is not determined.",
    ),
    click.Option(
        ["--quiet", "-q"],
        is_flag=True,
        help="Write nothing to stderr but errors, and warnings of doubtful rigs.",
    ),
)
SHARED: Mapping[str, click.Parameter] = {str(param.name): param for param in _ALL}


def intrinsics_if_any(help: str) -> click.Option:
    """Return a `--cameras` that may be left out."""
    return click.Option(
        ["--cameras"],
        default="",
        show_default=False,
        type=values.INTRINSICS,
        metavar="INTRINSICS",
        help=help,
    )


def calibration(cameras: str) -> tuple[str | click.Parameter, ...]:
    """Return the parameters of a command that calibrates; cameras: the help of `--cameras`."""
    return (intrinsics_if_any(cameras), *CALIBRATION)
