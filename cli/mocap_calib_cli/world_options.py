"""The options that say in which coordinates results are, and which lengths are known."""

from pathlib import Path

import click

from mocap_calib.config import WorldConfig
from mocap_calib_cli import values

WORLD_OPTIONS = {
    "axes": click.option(
        "--world",
        "axes",
        type=values.NAME_OR_FILE,
        default=WorldConfig.axes,
        metavar="WORLD",
        help="Coordinates of the results: floor (z up, the origin on it), first-camera, the name "
        "of a camera, or a FILE with cameras in a world of yours; auto: the floor where subjects "
        "show it, else the first camera.",
    ),
    "height": click.option(
        "--height",
        metavar="METRES|ID=METRES",
        multiple=True,
        help="Stature of who stands, or of one individual (0=1.75); 1.75+-0.01 with a standard "
        "deviation; may be repeated. Known lengths make the unit metres.",
    ),
    "length": click.option(
        "--length",
        metavar="A-B=METRES",
        multiple=True,
        help="Distance of two joints, as left_hip-left_knee=0.42+-0.01; may be repeated.",
    ),
    "camera_distance": click.option(
        "--camera-distance",
        metavar="A-B=METRES",
        multiple=True,
        help="Distance of two cameras, as cam1-cam2=3.1+-0.02; may be repeated.",
    ),
    "forward": click.option(
        "--forward",
        default="",
        show_default=False,
        metavar="A-B",
        help="What is ahead (y) on the floor: mostly from joint A to joint B. [default: as the "
        "first camera looks]",
    ),
    "align": click.option(
        "--align",
        type=click.Path(path_type=Path),
        metavar="LANDMARKS.csv",
        help="Points of the scene whose places are known, and where cameras see them: columns "
        "name,x,y,z,camera,u,v, metres and pixels. Results are in their coordinates.",
    ),
}
