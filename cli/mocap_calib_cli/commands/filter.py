"""mocap-calib filter: classic filters of 3D poses over time."""

from pathlib import Path

import click

from mocap_calib.config import FILTER_METHODS, FilterConfig
from mocap_calib_cli import options, values
from mocap_calib_cli.numbers import COUNT, POSITIVE


@click.command(name="filter")
@click.argument("poses", type=values.POSES, metavar="POSES")
@options.output_file("The filtered poses; the ending of the name says the format.")
@click.option(
    "--to",
    "target",
    metavar="FORMAT",
    shell_complete=values.offer_written_formats,
    help="Format of the output, where the ending of its name does not say it. [default: poses-h5 "
    "for .h5]",
)
@click.option(
    "--method",
    type=click.Choice(FILTER_METHODS),
    default=FilterConfig.method,
    help="butterworth (low pass, forwards and backwards: no delay), median, or savgol "
    "(Savitzky-Golay).",
)
@click.option(
    "--cutoff",
    type=POSITIVE,
    default=FilterConfig.cutoff,
    metavar="HZ",
    help="Of butterworth; needs the frames per second.",
)
@click.option(
    "--order",
    type=click.IntRange(min=2),
    default=FilterConfig.order,
    help="Of butterworth, both directions together: an even number.",
)
@click.option(
    "--window",
    type=COUNT,
    default=FilterConfig.window,
    metavar="FRAMES",
    help="Of median and savgol: an odd number.",
)
@click.option(
    "--polynomial", type=COUNT, default=FilterConfig.polynomial, help="Order of savgol's."
)
@click.option("--fps", type=POSITIVE, help="Frames per second, where the file does not say.")
@options.shared_options("quiet")
def command(
    shared: options.SharedOptions,
    poses: str,
    output: Path,
    target: str | None,
    method: str,
    cutoff: float,
    order: int,
    window: int,
    polynomial: int,
    fps: float | None,
) -> None:
    """Filter the 3D poses in POSES over time: a file of docs/formats.md, or the folder of a run.

    Nothing passes a gap: each joint is filtered from gap to gap, and what is missing stays
    missing. `run` and `smooth` know the cameras and the bones, and need no further filter.

    \b
    Example:
      mocap-calib filter out/poses3d.h5 -o filtered.h5 --cutoff 6 --fps 60
      mocap-calib filter poses.trc -o filtered.trc --method median --window 5
    """
    import math
    from dataclasses import replace
    from typing import cast

    from mocap_calib.config import FilterMethod
    from mocap_calib.errors import describe_lost
    from mocap_calib.io.conversion import load_pose_sources
    from mocap_calib.io.kinds import check_sources, choose_format
    from mocap_calib.io.poses.write import write_poses
    from mocap_calib.poses.filters import filter_poses
    from mocap_calib_cli import outputs
    from mocap_calib_cli.progress import Reporter

    for name, number, even in (("order", order, True), ("window", window, False)):
        if (number % 2 == 0) is not even:
            kind = "an even" if even else "an odd"
            raise click.UsageError(f"--{name}: expected {kind} number, found {number}")
    outputs.check_file(output)
    config = FilterConfig(
        method=cast(FilterMethod, method),
        order=order,
        cutoff=cutoff,
        window=window,
        polynomial=polynomial,
    )
    if target is None:
        own = output.suffix == ".h5"
        target = "poses-h5" if own else choose_format("poses", str(output))
    check_sources([poses])
    file = load_pose_sources([Path(poses)], None, fps)
    rate = file.rate if math.isfinite(file.rate) else None
    filtered = filter_poses(file.poses, config, fps=rate)
    lost = write_poses(output, replace(file, poses=filtered), target)
    Reporter(quiet=shared.quiet).say(*file.notes, *describe_lost(target, lost))
