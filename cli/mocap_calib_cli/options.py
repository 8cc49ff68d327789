"""The options that several commands share, each said once.

`@shared_options("cameras", "seed", ...)` adds options to a command and hands it one record,
`SharedOptions`, of what was typed. Options of a single command stand in its own module.
"""

import functools
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

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
from mocap_calib_cli import values
from mocap_calib_cli.file_options import FILE_OPTIONS
from mocap_calib_cli.numbers import COUNT, PERCENTAGE, SEED
from mocap_calib_cli.result_options import RESULT_OPTIONS
from mocap_calib_cli.world_options import WORLD_OPTIONS

Command = TypeVar("Command", bound=Callable[..., Any])

STDIO = "-"

# how keypoint files are to be read where they do not say it themselves, and what is wrong there
READING = tuple(name for name in FILE_OPTIONS if name not in ("moved", "mend"))
KEYPOINTS = ("keypoints", *READING)
MODEL = ("skeleton", "model", "device")
VERDICT = ("strict", "accept")
SCALE = ("height", "length", "camera_distance")
# how a recording is calibrated, and what is written of it
INTRINSICS = ("cameras", "refine", "focal_uncertainty", "focal_per_camera")
CALIBRATION = (
    *INTRINSICS,
    *MODEL,
    "individuals",
    "pairs",
    "solver",
    "seed",
    "scheduler",
    *READING,
    "moved",
    "mend",
    "sync",
    "sync_window",
    *WORLD_OPTIONS,
    "smooth",
    *RESULT_OPTIONS,
    *VERDICT,
    "quiet",
)


@dataclass(frozen=True)
class SharedOptions:
    """What was typed, as text; options that the command does not have are as if left out.

    keypoints ... views: the keypoint files and how to read them, see `texts.read_options`.
    mirrored ... moved: what is known to be wrong with them, see `texts.stated_mends`.
    cameras ... focal_per_camera: what is known of the intrinsics, see `inputs.intrinsics_config`.
    skeleton: file with names of joints of one's own. model: None = chosen by joint names.
    individuals: how many there are at most, None = nobody knows.
    pairs: of cameras that are calibrated. solver: of pairs.
    scheduler: address of a Dask scheduler, None = the work is done here.
    write: further formats of the results. fps: frames per second, see `texts.parse_rates`.
    report: whether report.html is written.
    sync, sync_window: what is done about clocks that differ, see `inputs.sync_config`.
    axes ... align: the coordinates of the results, see `world_texts.world_config`.
    smooth: what is done to poses, one of `config.SMOOTH_MODES`.
    strict, accept: which verdicts will do, see `verdicts.exit_status`.
    """

    keypoints: tuple[str, ...] = ()
    format: str | None = None
    layout: str | None = None
    image_size: tuple[str, ...] = ()
    camera_regex: str | None = None
    frame_offset: tuple[str, ...] = ()
    crop_offset: tuple[str, ...] = ()
    views: str | None = None
    mirrored: tuple[str, ...] = ()
    sides: tuple[str, ...] = ()
    rotated: tuple[str, ...] = ()
    resized: tuple[str, ...] = ()
    exchanged: tuple[str, ...] = ()
    moved: tuple[str, ...] = ()
    mend: str = MENDING[0]
    cameras: str = ""
    refine: str | None = None
    focal_uncertainty: float | None = None
    focal_per_camera: bool = False
    rig: str = ""
    matches: str = ""
    skeleton: Path | None = None
    model: str | None = None
    device: str = "cpu"
    individuals: int | None = None
    pairs: str = ViewGraphConfig.pairs
    solver: str = PAIR_SOLVERS[0]
    seed: int = 0
    scheduler: str | None = None
    write: tuple[str, ...] = ()
    fps: tuple[str, ...] = ()
    report: bool = True
    sync: str = SyncConfig.mode
    sync_window: int = SyncConfig.window
    axes: str = WorldConfig.axes
    height: tuple[str, ...] = ()
    length: tuple[str, ...] = ()
    camera_distance: tuple[str, ...] = ()
    forward: str = ""
    align: Path | None = None
    smooth: str = PosesConfig.smooth
    strict: bool = False
    accept: str | None = None
    quiet: bool = False


_OPTIONS = {
    **FILE_OPTIONS,
    **RESULT_OPTIONS,
    **WORLD_OPTIONS,
    "keypoints": click.argument(
        "keypoints", nargs=-1, required=True, type=values.KEYPOINTS, metavar="KEYPOINTS..."
    ),
    "cameras": click.option(
        "--cameras",
        required=True,
        type=values.INTRINSICS,
        metavar="INTRINSICS",
        help="File or folder with the cameras' intrinsics, in any format of docs/formats.md; "
        "- reads stdin.",
    ),
    "refine": click.option(
        "--refine",
        type=click.Choice(REFINEMENTS),
        metavar="WHAT",
        help="What of the intrinsics is estimated with the rig: none, focal (length), or focal+k1 "
        "(and the first coefficient of the lens). [default: none, without --cameras focal+k1]",
    ),
    "focal_uncertainty": click.option(
        "--focal-uncertainty",
        type=PERCENTAGE,
        metavar="SHARE",
        help="How good the focal lengths in INTRINSICS are, as 5%; they are estimated within it. "
        "[default: 50%]",
    ),
    "focal_per_camera": click.option(
        "--focal-per-camera",
        is_flag=True,
        help="Estimate the intrinsics of each camera by itself. [default: cameras of equal image "
        "size change alike]",
    ),
    "rig": click.option(
        "--rig",
        required=True,
        type=values.RIG,
        metavar="CAMERAS",
        help="File or folder with cameras and where they stand (docs/formats.md); - reads stdin.",
    ),
    "matches": click.option(
        "--matches",
        required=True,
        type=values.MATCHES,
        metavar="MATCHES",
        help="File of the command `match`; - reads stdin.",
    ),
    "skeleton": click.option(
        "--skeleton",
        type=click.Path(path_type=Path),
        metavar="FILE.yaml",
        help="Your names of joints: a mapping `aliases`, your name: joint.",
    ),
    "model": click.option(
        "--model",
        type=values.NAME_OR_FILE,
        metavar="NAME|FILE|none",
        shell_complete=values.offer_models,
        help="Network: shipped (see `models`) or one of your own; none: geometry alone. "
        "[default: by joint names]",
    ),
    "device": click.option(
        "--device",
        type=click.Choice(["cpu", "cuda"]),
        default=SharedOptions.device,
        help="Where the network computes.",
    ),
    "individuals": click.option(
        "--individuals",
        type=COUNT,
        metavar="N",
        help="How many individuals there are, where you know it: never more get a name, and those "
        "best supported do. [default: as many as the recording needs]",
    ),
    "pairs": click.option(
        "--pairs",
        type=click.Choice(PAIR_CHOICES),
        default=SharedOptions.pairs,
        help="Which pairs of more than "
        f"{ViewGraphConfig().small_rig} cameras are calibrated: those chosen by what they see in "
        "common, or all, which takes longer. Of fewer cameras, all are.",
    ),
    "solver": click.option(
        "--solver",
        type=click.Choice(PAIR_SOLVERS),
        default=SharedOptions.solver,
        metavar="NAME",
        help="How pairs of cameras are calibrated: search (ours), paper (its gradient descent, "
        "slow; through its own network with --model people_token), or five-point (its baseline).",
    ),
    "seed": click.option(
        "--seed",
        type=SEED,
        default=SharedOptions.seed,
        help="The same seed gives the same results.",
    ),
    "scheduler": click.option(
        "--scheduler",
        metavar="ADDRESS",
        help="Dask scheduler whose workers do the work (tcp://HOST:PORT); same results.",
    ),
    "sync": click.option(
        "--sync",
        type=click.Choice(SYNC_MODES),
        default=SharedOptions.sync,
        help="What is done where the clocks of cameras differ: auto puts them on one clock for "
        "this run, check only says so, off does not look.",
    ),
    "sync_window": click.option(
        "--sync-window",
        type=click.IntRange(min=1),
        default=SharedOptions.sync_window,
        metavar="FRAMES",
        help="By how much a camera may be early or late.",
    ),
    "smooth": click.option(
        "--smooth",
        type=click.Choice(SMOOTH_MODES),
        default=SharedOptions.smooth,
        help="What is done to the poses: auto fits them to motion and bones as strongly as "
        "held-out detections say, bones to bones alone, off leaves the triangulated points.",
    ),
    "strict": click.option(
        "--strict", is_flag=True, help="Exit status 1 where the rig is weak, too."
    ),
    "accept": click.option(
        "--accept",
        type=click.Choice(["not-determined"]),
        help="Exit status 0 also where the rig is not determined.",
    ),
    "quiet": click.option(
        "--quiet",
        "-q",
        is_flag=True,
        help="Write nothing to stderr but errors, and warnings of doubtful rigs.",
    ),
}


def shared_options(*names: str, **changed: Callable[..., Any]) -> Callable[[Command], Command]:
    """Add these options to a command, which gets what was typed as its first argument.

    changed: options that the command says in other words, by the name of the field.
    """
    known = _OPTIONS | changed

    def add(command: Command) -> Command:
        @functools.wraps(command)
        def collect(**values: Any) -> Any:
            typed = {name: values.pop(name) for name in names}
            return command(SharedOptions(**typed), **values)

        for name in reversed(names):
            collect = known[name](collect)
        return collect  # type: ignore[return-value]  # click keeps the kind of what it decorates

    return add


def output_text(what: str) -> Callable[[Command], Command]:
    """Add `-o FILE` to a command whose result is text: stdout unless a file is given."""
    return click.option(
        "-o",
        "--output",
        default=STDIO,
        type=values.ANY_PATH,
        metavar="FILE",
        help=f"Where to write the {what}; - is stdout.",
    )


def output_file(what: str) -> Callable[[Command], Command]:
    """Add `-o FILE` to a command whose result is a file."""
    return _output("FILE", what)


def output_folder(what: str) -> Callable[[Command], Command]:
    """Add `-o OUT` to a command whose result is a folder."""
    return _output("OUT", what)


def as_json(what: str) -> Callable[[Command], Command]:
    """Add `--json`."""
    return click.option("--json", "as_json", is_flag=True, help=what)


def _output(metavar: str, what: str) -> Callable[[Command], Command]:
    """Add a required `-o` with a path."""
    return click.option(
        "-o",
        "--output",
        type=click.Path(path_type=Path),
        required=True,
        metavar=metavar,
        help=what,
    )
