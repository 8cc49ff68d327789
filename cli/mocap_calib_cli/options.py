"""The options that several commands share, each once: its help here, its type below.

keypoints: Folder with the 2D keypoints, or a file for each camera; docs/formats.md lists the
    formats.
format: Format of the keypoint files, where their content does not show it (docs/formats.md).
layout: Names of the keypoints in files that do not name them: body_25, body_25b, coco_17, ... or
    a,b,c.
image_size: Size of the images in pixels, where the files do not say it, of all cameras or of one;
    positions from 0 to 1 are multiplied by it.
camera_regex: Finds the camera's name in a path: its group `camera`, its first group, or all of it.
frame_offset: Added to the frame numbers of a camera; may be given for each camera.
crop_offset: Corner of the part of the image in which a camera's keypoints were found.
views: Views in one file: endings of keypoint names (paw_A, paw_B), each a camera.
mirrored: The video of this camera is mirrored, left for right.
flipped: The y axis of this camera's keypoints goes up.
sides: Left and right are exchanged in the names of this camera's keypoints.
rotated: The images of a camera are turned clockwise against its intrinsics, by 90, 180 or 270
    degrees.
resized: The images of a camera are so many times as large as its intrinsics say, or wide and high.
exchanged: The intrinsics of these two cameras are exchanged.
moved: A camera stands, or looks, elsewhere from this frame on.
mend: What is done where the files of a camera turn out to be wrong: auto mends for this run what
    has one right way, none only names it.
cameras: File or folder with the cameras' intrinsics, in any format of docs/formats.md; - reads
    stdin.
refine: What of the intrinsics is estimated with the rig: none, focal (length), or focal+k1 (and the
    first coefficient of the lens). [default: none, without --cameras focal+k1]
centre_uncertainty: How well the given principal points are known, as 0.2% of the longer
    image side. [default: 0.5%, and less where they are far from the middle of the image]
focal_uncertainty: How well the given focal lengths are known, as 2%; with --refine they are
    estimated within it. [default: 50% with --refine, else as the recording has it]
focal_per_camera: Estimate the intrinsics of each camera by itself. [default: cameras of equal image
    size change alike]
rig: File or folder with cameras and where they stand (docs/formats.md); - reads stdin.
matches: File of the command `match`; - reads stdin.
skeleton: Your names of joints: a mapping `aliases`, your name: joint.
model: Network: shipped (see `models`) or one of your own; none: geometry alone. [default: by joint
    names]
device: Where the network computes.
individuals: How many individuals there are, where you know it: never more get a name, and those
    best supported do. [default: as many as the recording needs]
pairs: Which pairs of more than 17 cameras are calibrated: those chosen by what they see in common,
    or all, which takes longer. Of fewer cameras, all are.
solver: How pairs of cameras are calibrated: search (ours), paper (its gradient descent, slow;
    through its own network with --model people_token), or five-point (its baseline).
seed: The same seed gives the same results.
scheduler: Dask scheduler whose workers do the work (tcp://HOST:PORT); same results.
sync: What is done where the clocks of cameras differ: auto puts them on one clock for this run,
    check only says so, off does not look.
sync_window: By how much a camera may be early or late.
world: Coordinates of the results: floor (z up, the origin on it), first-camera, the name of a
    camera, or a FILE with cameras in a world of yours; auto: the floor where subjects show it, else
    the first camera.
height: Stature of who stands, or of one individual (0=1.75); 1.75+-0.01 with a standard deviation;
    may be repeated. Known lengths make the unit metres.
length: Distance of two joints, as left_hip-left_knee=0.42+-0.01; may be repeated.
camera_distance: Distance of two cameras, as cam1-cam2=3.1+-0.02; may be repeated.
forward: What is ahead (y) on the floor: mostly from joint A to joint B. [default: as the first
    camera looks]
align: Points of the scene whose places are known, and where cameras see them: columns
    name,x,y,z,camera,u,v, metres and pixels. Results are in their coordinates.
smooth: What is done to the poses: auto fits them to motion and bones as strongly as held-out
    detections say, bones to bones alone, off leaves the triangulated points.
write: Write this format too (colmap, movement-3d, ...: docs/formats.md); may be repeated. Those in
    metres need a known length: --height, --length, --camera-distance.
fps: Frames per second, for the formats that need it and for report.html; and of a single camera
    whose rate is another.
report: Write report.html, which shows the results in a browser.
strict: Exit status 1 where the rig is weak, too.
accept: Exit status 0 also where the rig is not determined.
quiet: Write nothing to stderr but errors, and warnings of doubtful rigs.
output: Folder to write; made when missing.
"""

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
from mocap_calib_cli.docstrings import split_help
from mocap_calib_cli.outputs import STDIO

# how keypoint files are to be read where they do not say it themselves, and what is wrong there
READING = (
    *("format", "layout", "image_size", "camera_regex", "frame_offset", "crop_offset", "views"),
    *("mirrored", "flipped", "sides", "rotated", "resized", "exchanged"),
)
KEYPOINTS = ("keypoints", *READING)
MODEL = ("skeleton", "model", "device")
VERDICT = ("strict", "accept")
SCALE = ("height", "length", "camera_distance")
# how a recording is calibrated, and what is written of it
CALIBRATION = (
    *("centre_uncertainty", "refine", "focal_uncertainty", "focal_per_camera"),
    *MODEL,
    *("individuals", "pairs", "solver", "seed", "scheduler"),
    *READING,
    *("moved", "mend", "sync", "sync_window", "world", *SCALE, "forward", "align", "smooth"),
    *("write", "fps", "report", *VERDICT, "quiet"),
)


class Word(click.Choice[str]):
    """One of a few words."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """Return the word. Raises click's BadParameter."""
        if value not in self.choices:
            self.fail(f"expected one of {', '.join(self.choices)}, found {value}", param, ctx)
        return str(value)


class _Flag(click.types.BoolParamType):
    """Whether a flag is set, which a file of options says as true or false."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> bool:
        """Return whether it is. Raises click's BadParameter."""
        try:
            return bool(super().convert(value, param, ctx))
        except click.BadParameter:
            self.fail(f"expected true or false, found {value}", param, ctx)


HELP = split_help(__doc__)[1]


def option(
    flags: str,
    kind: click.ParamType[Any] | tuple[str, ...] | None = None,
    of: object = None,
    **more: Any,
) -> click.Option:
    """Return an option.

    flags: with blanks between them. kind: its type, or the words that it may be; None: a flag.
    of: a record whose field of this name is the default. more: as click has it.

    The help is in the docstring of the command, or in that of this module.
    """
    if kind is None:
        return click.Option(flags.split(), is_flag=True, type=_Flag(), **more)
    kind = Word(kind) if isinstance(kind, tuple) else kind
    found = click.Option(flags.split(), type=kind, **more)
    if of is not None:
        found.default = getattr(of, str(found.name))
    return found


def argument(
    name: str, kind: click.ParamType[Any], metavar: str = "", *, several: bool = False, **more: Any
) -> click.Argument:
    """Return an argument; several: any number of values, and one at least where it is required."""
    metavar = metavar or name.upper() + ("..." if several else "")
    return click.Argument(
        [name], type=kind, metavar=metavar, nargs=-1 if several else 1, **{"required": True} | more
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


# --- parameters of one name whose help, or whether they are required, is each command's own

CAMERAS_IF_ANY = option("--cameras", values.INTRINSICS, metavar="INTRINSICS")
OUTPUT_TEXT = option("-o --output", values.OUTPUT, default=STDIO, metavar="FILE")
OUTPUT_FILE = option("-o --output", values.OUTPUT, required=True, metavar="FILE")
OUTPUT_FOLDER = option("-o --output", values.OUTPUT_FOLDER, required=True, metavar="OUT")
AS_JSON = option("--json as_json")
RATE_OF_POSES = option("--fps", numbers.POSITIVE)

_ALL: tuple[click.Parameter, ...] = (
    argument("keypoints", values.KEYPOINTS, several=True),
    option("--format", names.KEYPOINT_FORMAT),
    option("--layout", names.LAYOUT),
    option("--image-size", values.IMAGE_SIZE, multiple=True),
    option("--camera-regex", values.PATTERN),
    option("--frame-offset", values.FRAME_OFFSET, multiple=True),
    option("--crop-offset", values.CROP_OFFSET, multiple=True),
    option("--views", values.VIEWS),
    option("--mirrored", values.CAMERA, multiple=True),
    option("--flipped", values.CAMERA, multiple=True),
    option("--sides", values.CAMERA, multiple=True),
    option("--rotated", values.ROTATED, multiple=True),
    option("--resized", values.RESIZED, multiple=True),
    option("--exchanged", values.EXCHANGED, multiple=True),
    option("--moved", values.MOVED, multiple=True),
    option("--mend", MENDING, default=MENDING[0]),
    option("--cameras", values.INTRINSICS, required=True, metavar="INTRINSICS"),
    option("--centre-uncertainty", values.PERCENTAGE),
    option("--refine", REFINEMENTS, metavar="WHAT"),
    option("--focal-uncertainty", values.PERCENTAGE),
    option("--focal-per-camera"),
    option("--rig", values.INPUT, required=True, metavar="CAMERAS"),
    option("--matches", values.INPUT, required=True, metavar="MATCHES"),
    option("--skeleton", values.FILE, metavar="FILE.yaml"),
    option("--model", names.MODEL),
    option("--device", ("cpu", "cuda"), default="cpu"),
    option("--individuals", numbers.COUNT, metavar="N"),
    option("--pairs", PAIR_CHOICES, default=ViewGraphConfig.pairs),
    option("--solver", PAIR_SOLVERS, default=PAIR_SOLVERS[0], metavar="NAME"),
    option("--seed", numbers.SEED, default=0),
    option("--scheduler", click.STRING, metavar="ADDRESS"),
    option("--sync", SYNC_MODES, default=SyncConfig.mode),
    option(
        "--sync-window",
        numbers.Number(whole=True, min=1),
        default=SyncConfig.window,
        metavar="FRAMES",
    ),
    option("--world", names.WORLD, default=WorldConfig.axes),
    option("--height", values.HEIGHT, multiple=True),
    option("--length", values.LENGTH, multiple=True),
    option("--camera-distance", values.CAMERA_DISTANCE, multiple=True),
    option("--forward", click.STRING, default="", show_default=False, metavar="A-B"),
    option("--align", values.FILE, metavar="LANDMARKS.csv"),
    option("--smooth", SMOOTH_MODES, default=PosesConfig.smooth),
    option("--write", names.RESULT_FORMAT, multiple=True),
    option("--fps", values.RATE, multiple=True, callback=_check_rates),
    option("--report/--no-report", default=True),
    option("--strict"),
    option("--accept", ("not-determined",)),
    option("--quiet -q"),
)
SHARED: Mapping[str, click.Parameter] = {str(param.name): param for param in _ALL}
