"""Options that say what is written of a calibration."""

import click

from mocap_calib_cli import values

RESULT_OPTIONS = {
    "write": click.option(
        "--write",
        metavar="FORMAT",
        shell_complete=values.offer_result_formats,
        multiple=True,
        help="Write this format too (colmap, movement-3d, ...: docs/formats.md); may be repeated. "
        "Those in metres need a known length: --height, --length, --camera-distance.",
    ),
    "fps": click.option(
        "--fps",
        metavar="FPS|CAM:FPS",
        multiple=True,
        help="Frames per second, for the formats that need it and for report.html; and of a single "
        "camera whose rate is another.",
    ),
    "report": click.option(
        "--report/--no-report",
        default=True,
        help="Write report.html, which shows the results in a browser.",
    ),
}
