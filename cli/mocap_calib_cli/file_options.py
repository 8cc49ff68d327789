"""Options that say how keypoint files are read, and what is known to be wrong with them."""

import click

from mocap_calib.config import MENDING
from mocap_calib_cli import values

FILE_OPTIONS = {
    "format": click.option(
        "--format",
        metavar="NAME",
        shell_complete=values.offer_keypoint_formats,
        help="Format of the keypoint files, where their content does not show it "
        "(docs/formats.md).",
    ),
    "layout": click.option(
        "--layout",
        metavar="NAME",
        shell_complete=values.offer_layouts,
        help="Names of the keypoints in files that do not name them: body_25, body_25b, coco_17, "
        "... or a,b,c.",
    ),
    "image_size": click.option(
        "--image-size",
        metavar="WxH|CAM:WxH",
        multiple=True,
        help="Size of the images in pixels, where the files do not say it, of all cameras or of "
        "one; positions from 0 to 1 are multiplied by it.",
    ),
    "camera_regex": click.option(
        "--camera-regex",
        metavar="REGEX",
        help="Finds the camera's name in a path: its group `camera`, its first group, or all of "
        "it.",
    ),
    "frame_offset": click.option(
        "--frame-offset",
        metavar="CAM:N",
        multiple=True,
        help="Added to the frame numbers of a camera; may be given for each camera.",
    ),
    "crop_offset": click.option(
        "--crop-offset",
        metavar="CAM:X,Y",
        multiple=True,
        help="Corner of the part of the image in which a camera's keypoints were found.",
    ),
    "views": click.option(
        "--views",
        metavar="A,B",
        help="Views in one file: endings of keypoint names (paw_A, paw_B), each a camera.",
    ),
    "mirrored": click.option(
        "--mirrored",
        metavar="CAM",
        multiple=True,
        help="The video of this camera is mirrored, left for right.",
    ),
    "sides": click.option(
        "--sides",
        metavar="CAM",
        multiple=True,
        help="Left and right are exchanged in the names of this camera's keypoints.",
    ),
    "rotated": click.option(
        "--rotated",
        metavar="CAM:DEG",
        multiple=True,
        help="The images of a camera are turned clockwise against its intrinsics, by 90, 180 or "
        "270 degrees.",
    ),
    "resized": click.option(
        "--resized",
        metavar="CAM:FACTOR",
        multiple=True,
        help="The images of a camera are so many times as large as its intrinsics say.",
    ),
    "exchanged": click.option(
        "--exchanged",
        metavar="A,B",
        multiple=True,
        help="The intrinsics of these two cameras are exchanged.",
    ),
    "moved": click.option(
        "--moved",
        metavar="CAM:FRAME",
        multiple=True,
        help="A camera stands, or looks, elsewhere from this frame on.",
    ),
    "mend": click.option(
        "--mend",
        type=click.Choice(MENDING),
        default=MENDING[0],
        help="What is done where the files of a camera turn out to be wrong: auto mends for this "
        "run what has one right way, none only names it.",
    ),
}
