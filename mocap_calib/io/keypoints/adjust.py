"""Apply what the user says of detections that were read.

Views inside one file, positions that are shares of the image, clocks that start elsewhere, cropped
images.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mocap_calib.config import LARGEST_SHARE, LEAST_SHARE
from mocap_calib.errors import MismatchError, argument
from mocap_calib.io.file import LARGEST_FRAME
from mocap_calib.io.keypoints.options import ReadOptions
from mocap_calib.recording.names import compose_name
from mocap_calib.types import Keypoints2D


def split_views(view: Keypoints2D, suffixes: tuple[str, ...]) -> tuple[Keypoints2D, ...]:
    """Return the cameras of a file whose keypoint names end in the view (`paw_top`, `paw_bot`).

    Each camera is called by its suffix. Raises MismatchError where a keypoint has none of the
    suffixes.
    """
    if not suffixes:
        return (view,)
    keypoints_of: dict[str, list[int]] = {}
    for index, name in enumerate(view.keypoints):
        keypoints_of.setdefault(_suffix_of(name, suffixes, view.source), []).append(index)
    return tuple(
        _camera_of_suffix(view, suffix, indices) for suffix, indices in keypoints_of.items()
    )


def _suffix_of(keypoint: str, suffixes: tuple[str, ...], source: str) -> str:
    """Return the suffix in which a keypoint's name ends. Raises MismatchError where it has none."""
    for suffix in suffixes:
        if keypoint.endswith(f"_{suffix}"):
            return suffix
    raise MismatchError(
        source,
        f"every keypoint to end in _{' or _'.join(suffixes)}",
        keypoint,
        f"change {argument('views')}",
    )


def _camera_of_suffix(view: Keypoints2D, suffix: str, indices: list[int]) -> Keypoints2D:
    """Return the camera of these keypoints (indices), whose names lose the suffix."""
    return replace(
        view,
        camera=suffix,
        keypoints=tuple(view.keypoints[index].removesuffix(f"_{suffix}") for index in indices),
        positions=view.positions[:, :, indices],
        confidence=view.confidence[:, :, indices],
    )


def convert_to_pixels(view: Keypoints2D, size: tuple[int, int]) -> Keypoints2D:
    """Return the view with the image size that the user gives, where the file has none.

    Positions that are shares of the image are multiplied by it. Raises MismatchError where they
    are shares of something else.
    """
    if size == (0, 0):
        return view
    if np.nanmax(np.abs(view.positions), initial=0.0) > LARGEST_SHARE:
        return replace(view, image_size=size) if view.image_size == (0, 0) else view
    _check_shares(view, size)
    scale = np.array(size, dtype=view.positions.dtype)
    return replace(view, positions=view.positions * scale, image_size=size)


def _check_shares(view: Keypoints2D, size: tuple[int, int]) -> None:
    """Raise MismatchError where positions are not shares of images of this size."""
    if view.image_size not in ((0, 0), size):
        stated = "{}x{}".format(*view.image_size)
        given = "{}x{}".format(*size)
        raise MismatchError(
            view.source,
            f"images of {stated}, as the file says",
            argument("image_size", given),
            "change it",
        )
    least = np.nanmin(view.positions, initial=0.0)
    if least < LEAST_SHARE:
        raise MismatchError(
            view.source,
            "pixels, or shares of the image from 0 to 1",
            f"{least:.2f}",
            "export pixels",
        )


def apply_offsets(views: Sequence[Keypoints2D], options: ReadOptions) -> tuple[Keypoints2D, ...]:
    """Return the views with the user's offsets of frames and pixels.

    Raises MismatchError for offsets, and image sizes, of cameras that are not there.
    """
    known = {view.camera for view in views}
    for camera in options.image_sizes:
        if compose_name(camera) not in known:
            raise MismatchError(
                "",
                f"image sizes of the cameras {', '.join(sorted(known))}",
                f"one of {camera}",
                "change its name",
            )
    frame_offset = {compose_name(camera): n for camera, n in options.frame_offset.items()}
    crop_offset = {compose_name(camera): xy for camera, xy in options.crop_offset.items()}
    for camera in (*frame_offset, *crop_offset):
        if camera not in known:
            raise MismatchError(
                "",
                f"offsets of the cameras {', '.join(sorted(known))}",
                f"one of {camera}",
                "change its name",
            )
    return tuple(
        _apply_offset(
            view,
            frames=frame_offset.get(view.camera, 0),
            pixels=crop_offset.get(view.camera, (0.0, 0.0)),
        )
        for view in views
    )


def _apply_offset(view: Keypoints2D, *, frames: int, pixels: tuple[float, float]) -> Keypoints2D:
    """Return the view with these numbers added to its frame numbers and to its positions."""
    if not len(view.frames) or (not frames and pixels == (0.0, 0.0)):
        return view
    first = int(view.frames[0]) + frames
    last = int(view.frames[-1]) + frames
    if first < 0 or last >= LARGEST_FRAME:
        raise MismatchError(
            view.source,
            "frame numbers from 0 on",
            f"{first} after the offset",
            f"change {argument('frame_offset')}",
        )
    return replace(view, frames=view.frames + frames, positions=view.positions + np.array(pixels))
