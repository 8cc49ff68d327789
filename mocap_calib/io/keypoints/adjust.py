"""What the user says of the detections that were read: views inside one file, shares of images, clocks that start elsewhere, cropped images."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mocap_calib.config import ReadConfig
from mocap_calib.errors import MismatchError
from mocap_calib.io.keypoints.document import ReadOptions
from mocap_calib.types import Keypoints2D

_BEYOND = (
    0.25  # of the image, that a position may lie before it; more is another scale, such as -1 to 1
)


def split_views(view: Keypoints2D, suffixes: tuple[str, ...]) -> tuple[Keypoints2D, ...]:
    """The cameras in a file whose keypoints say which they are of (`paw_top`, `paw_bot`), called by the suffix.

    Raises MismatchError where a keypoint has none of the suffixes.
    """
    if not suffixes:
        return (view,)
    ends = [
        next((suffix for suffix in suffixes if name.endswith(f"_{suffix}")), None)
        for name in view.keypoints
    ]
    if None in ends:
        found = view.keypoints[ends.index(None)]
        raise MismatchError(
            f"{view.source}: expected every keypoint to end in _{' or _'.join(suffixes)}, found {found}; change --views"
        )
    parts = []
    for suffix in dict.fromkeys(ends):
        own = [k for k, end in enumerate(ends) if end == suffix]
        names = tuple(view.keypoints[k].removesuffix(f"_{suffix}") for k in own)
        parts.append(
            replace(
                view,
                camera=str(suffix),
                keypoints=names,
                positions=view.positions[:, :, own],
                confidence=view.confidence[:, :, own],
            )
        )
    return tuple(parts)


def in_pixels(view: Keypoints2D, size: tuple[int, int]) -> Keypoints2D:
    """The view with the image size that the user gives, where the file has none; positions that are shares of the image multiplied by it.

    Raises MismatchError where they are shares of something else.
    """
    if size == (0, 0):
        return view
    if np.nanmax(np.abs(view.positions), initial=0.0) > ReadConfig().largest_share:
        return replace(view, image_size=size) if view.image_size == (0, 0) else view
    if view.image_size not in ((0, 0), size):
        stated, given = (f"{width}x{height}" for width, height in (view.image_size, size))
        raise MismatchError(
            f"{view.source}: expected images of {stated}, as the file says, found --image-size {given}; change it"
        )
    least = np.nanmin(view.positions, initial=0.0)
    if least < -_BEYOND:
        raise MismatchError(
            f"{view.source}: expected pixels, or shares of the image from 0 to 1, found {least:.2f}; export pixels"
        )
    return replace(
        view, positions=view.positions * np.array(size, dtype=view.positions.dtype), image_size=size
    )


def moved(views: Sequence[Keypoints2D], options: ReadOptions) -> tuple[Keypoints2D, ...]:
    """The views with the user's offsets of frames and pixels. Raises MismatchError for offsets of cameras that are not there."""
    known = {view.camera for view in views}
    stranger = next(
        (camera for camera in (*options.frame_offset, *options.crop_offset) if camera not in known),
        None,
    )
    if stranger is not None:
        raise MismatchError(
            f"expected offsets of the cameras {', '.join(sorted(known))}, found one of {stranger}; change its name"
        )
    return tuple(
        _moved(
            view,
            options.frame_offset.get(view.camera, 0),
            options.crop_offset.get(view.camera, (0.0, 0.0)),
        )
        for view in views
    )


def _moved(view: Keypoints2D, frames: int, pixels: tuple[float, float]) -> Keypoints2D:
    if not len(view.frames) or (not frames and pixels == (0.0, 0.0)):
        return view
    first, last = (int(number) + frames for number in (view.frames[0], view.frames[-1]))
    if first < 0 or last >= 2**62:
        raise MismatchError(
            f"{view.source}: expected frame numbers from 0 on, found {first} after the offset; change --frame-offset"
        )
    return replace(view, frames=view.frames + frames, positions=view.positions + np.array(pixels))
