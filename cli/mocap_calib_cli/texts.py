"""What the texts of options say of how files are read, and of what is wrong with them.

Imports the readers: commands import this module when they run, so that --help is quick.
"""

import re
from collections.abc import Mapping, Sequence

import click

from mocap_calib.io.file import LARGEST_EXACT_FLOAT
from mocap_calib.io.keypoints.layouts import parse_layout
from mocap_calib.io.keypoints.options import ReadOptions
from mocap_calib.recording.corrections import Exchanged, Mirrored, Moved, Resized, Rotated, Sides
from mocap_calib.results import Mend
from mocap_calib_cli.options import SharedOptions
from mocap_calib_cli.values import wrong_form

# how the values of options are written
_FORMS = {
    "--image-size": "a width and a height above 0, as 1280x720",
    "--frame-offset": "camera:frames with a whole number, as cam1:-3",
    "--crop-offset": "camera:x,y, as cam1:640,0",
    "--rotated": "camera:degrees with 90, 180 or 270, as cam1:90",
    "--resized": "camera:factor above 0, as cam1:0.5",
    "--exchanged": "two cameras, as cam1,cam2",
    "--fps": "frames per second above 0, or camera:frames per second, as cam1:25",
    "--moved": "camera:frame with a whole number, as cam1:500",
}


def read_options(options: SharedOptions) -> ReadOptions:
    """Return how keypoint files are read. Raises MismatchError and click's BadParameter."""
    size_of_all, sizes = parse_image_sizes(options.image_size)
    return ReadOptions(
        layout=parse_layout(options.layout) if options.layout else (),
        image_size=size_of_all,
        image_sizes=sizes,
        camera_pattern=_check_pattern(options.camera_regex or ""),
        frame_offset=_parse_frame_offsets(options.frame_offset),
        crop_offset=_parse_crop_offsets(options.crop_offset),
        views=tuple(options.views.split(",")) if options.views else (),
    )


def stated_mends(options: SharedOptions) -> tuple[Mend, ...]:
    """Return what is said to be wrong with the files. Raises click's BadParameter.

    Images are turned before they are resized, and a camera that moved is split in the end.
    """
    return (
        *_parse_exchanged(options.exchanged),
        *(Mirrored(camera) for camera in options.mirrored),
        *(Sides(camera) for camera in options.sides),
        *_parse_rotated(options.rotated),
        *_parse_resized(options.resized),
        *_parse_moved(options.moved),
    )


def parse_rates(texts: Sequence[str]) -> tuple[float | None, dict[str, float]]:
    """Return the frames per second of all cameras, None where not said, and those of single ones.

    Raises click's BadParameter, also where single ones are said and not that of the others.
    """
    option, rates = "--fps", dict[str, float]()
    for text in texts:
        camera, _, rate = text.rpartition(":")
        (rates[camera],) = _parse_numbers(rate, 1, option)
        if rates[camera] <= 0:
            raise wrong_form(_FORMS[option], text, option)
    of_all = rates.pop("", None)
    if rates and of_all is None:
        raise click.BadParameter(
            f"expected that of the other cameras too, as --fps 30, found {', '.join(texts)} alone",
            param_hint=option,
        )
    return of_all, rates


def _parse_exchanged(texts: Sequence[str]) -> list[Mend]:
    """Return the mend of each `A,B`."""
    pairs = [text.split(",") for text in texts]
    for text, pair in zip(texts, pairs, strict=True):
        if len(pair) != 2 or not all(pair) or pair[0] == pair[1]:
            raise wrong_form(_FORMS["--exchanged"], text, "--exchanged")
    return [Exchanged(first, second) for first, second in pairs]


def _parse_rotated(texts: Sequence[str]) -> list[Mend]:
    """Return the mend of each `CAM:DEG`."""
    option = "--rotated"
    mends: list[Mend] = []
    for camera, text in _split_by_camera(texts, option).items():
        (degrees,) = _parse_whole_numbers(text, 1, option)
        if degrees not in (90, 180, 270):
            raise wrong_form(_FORMS[option], text, option)
        mends.append(Rotated(camera, degrees))
    return mends


def _parse_resized(texts: Sequence[str]) -> list[Mend]:
    """Return the mend of each `CAM:FACTOR`."""
    option = "--resized"
    mends: list[Mend] = []
    for camera, text in _split_by_camera(texts, option).items():
        (factor,) = _parse_numbers(text, 1, option)
        if factor <= 0:
            raise wrong_form(_FORMS[option], text, option)
        mends.append(Resized(camera, factor))
    return mends


def _parse_moved(texts: Sequence[str]) -> list[Mend]:
    """Return the mend of each `CAM:FRAME`; a camera may have moved several times."""
    option = "--moved"
    mends: list[Mend] = []
    for text in texts:
        for camera, frame in _split_by_camera([text], option).items():
            mends.append(Moved(camera, _parse_whole_numbers(frame, 1, option)[0]))
    return mends


def parse_image_sizes(
    texts: Sequence[str],
) -> tuple[tuple[int, int], dict[str, tuple[int, int]]]:
    """Return (width, height) of all cameras, of `WxH`, and of single ones, of `CAM:WxH`.

    (0, 0) where the former is not said; the last one counts. Raises click's BadParameter.
    """
    sizes = {}
    for text in texts:
        camera, _, size = text.rpartition(":")
        sizes[camera] = _parse_image_size(size)
    return sizes.pop("", (0, 0)), sizes


def _parse_image_size(text: str) -> tuple[int, int]:
    """Return (width, height) of `WxH`. Raises click's BadParameter."""
    width, height = _parse_whole_numbers(text.lower().replace("x", ","), 2, "--image-size")
    if min(width, height) <= 0:
        raise wrong_form(_FORMS["--image-size"], text, "--image-size")
    return width, height


def _check_pattern(pattern: str) -> str:
    """Return a regular expression that is one. Raises click's BadParameter."""
    try:
        re.compile(pattern)
    except re.error as error:
        raise click.BadParameter(
            f"expected a regular expression, as 'cam[0-9]+', found {pattern} ({error})",
            param_hint="--camera-regex",
        ) from None
    return pattern


def _parse_frame_offsets(texts: Sequence[str]) -> dict[str, int]:
    """Return camera -> offset of each `CAM:N`."""
    option = "--frame-offset"
    offsets = _split_by_camera(texts, option)
    return {camera: _parse_whole_numbers(text, 1, option)[0] for camera, text in offsets.items()}


def _parse_crop_offsets(texts: Sequence[str]) -> dict[str, tuple[float, float]]:
    """Return camera -> (x, y) of each `CAM:X,Y`."""
    option = "--crop-offset"
    offsets = {}
    for camera, text in _split_by_camera(texts, option).items():
        x, y = _parse_numbers(text, 2, option)
        offsets[camera] = (x, y)
    return offsets


def _split_by_camera(texts: Sequence[str], option: str) -> Mapping[str, str]:
    """Return camera -> value of each `camera:value`; the last one counts of a camera."""
    pairs = [text.rpartition(":") for text in texts]
    if not all(camera for camera, _, _ in pairs):
        raise wrong_form(_FORMS[option], ", ".join(texts), option)
    return {camera: value for camera, _, value in pairs}


def _parse_whole_numbers(text: str, count: int, option: str) -> list[int]:
    """Return `count` whole numbers with commas between them."""
    values = _parse_numbers(text, count, option)
    if any(value % 1 for value in values):
        raise wrong_form(_FORMS[option], text, option)
    return [int(value) for value in values]


def _parse_numbers(text: str, count: int, option: str) -> list[float]:
    """Return `count` numbers with commas between them."""
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        raise wrong_form(_FORMS[option], text, option) from None
    if len(values) != count or not all(abs(value) < LARGEST_EXACT_FLOAT for value in values):
        raise wrong_form(_FORMS[option], text, option)
    return values
