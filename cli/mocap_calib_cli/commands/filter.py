"""mocap-calib filter: classic filters of 3D poses over time."""

import click

from mocap_calib.config import FILTER_METHODS, FilterConfig
from mocap_calib_cli import names, numbers, values
from mocap_calib_cli.options import OUTPUT_FILE, RATE_OF_POSES, argument, option
from mocap_calib_cli.typed import Typed, as_command

_DEFAULT = FilterConfig()


def _check_parity(_: click.Context, param: click.Parameter, value: int) -> int:
    """Return an order that is even, or a window that is odd. Raises click's BadParameter."""
    is_even = value % 2 == 0
    if is_even != (param.name == "order"):
        kind = "an odd" if is_even else "an even"
        raise click.BadParameter(f"expected {kind} number, found {value}")
    return value


@as_command(
    "filter",
    argument("poses", values.INPUT),
    OUTPUT_FILE,
    option("--to", names.WRITTEN_FORMAT),
    option("--method", FILTER_METHODS, _DEFAULT),
    option("--cutoff", numbers.POSITIVE, _DEFAULT, metavar="HZ"),
    option("--order", numbers.Number(whole=True, min=2), _DEFAULT, callback=_check_parity),
    option("--window", numbers.COUNT, _DEFAULT, callback=_check_parity, metavar="FRAMES"),
    option("--polynomial", numbers.COUNT, _DEFAULT),
    RATE_OF_POSES,
    "quiet",
)
def command(typed: Typed) -> None:
    """Filter the 3D poses in POSES over time: a file of docs/formats.md, or the folder of a run.

    Nothing passes a gap: each joint is filtered from gap to gap, and what is missing stays
    missing. `run` and `smooth` know the cameras and the bones, and need no further filter.

    \b
    Example:
      mocap-calib filter out/poses3d.h5 -o filtered.h5 --cutoff 6 --fps 60
      mocap-calib filter poses.trc -o filtered.trc --method median --window 5

    poses: 3D poses: the folder of `run`, or files of a 3D format of docs/formats.md.
    output: The filtered poses; the ending of the name says the format.
    to: Format of the output, where the ending of its name does not say it. [default: poses-h5 for
        .h5]
    method: butterworth (low pass, forwards and backwards: no delay), median, or savgol
        (Savitzky-Golay).
    cutoff: Of butterworth; needs the frames per second.
    order: Of butterworth, both directions together: an even number.
    window: Of median and savgol: an odd number.
    polynomial: Order of savgol's.
    fps: Frames per second, where the file does not say.
    """
    import math
    from dataclasses import replace
    from pathlib import Path

    from mocap_calib.errors import describe_lost
    from mocap_calib.io.conversion import load_pose_sources
    from mocap_calib.io.kinds import check_sources, choose_format
    from mocap_calib.io.pose_files import write_poses
    from mocap_calib.stages import filter
    from mocap_calib_cli.screen import Reporter

    own = "poses-h5" if typed.output.suffix == ".h5" else ""
    target = typed.to or own or choose_format("poses", str(typed.output))
    check_sources([typed.poses])
    file = load_pose_sources([Path(typed.poses)], None, typed.fps)
    rate = file.rate if math.isfinite(file.rate) else None
    settings = {name: getattr(typed, name) for name in vars(_DEFAULT)}
    filtered = filter(file.poses, fps=rate, **settings)
    lost = write_poses(typed.output, replace(file, poses=filtered), target)
    Reporter(quiet=typed.quiet).say(*file.notes, *describe_lost(target, lost))
