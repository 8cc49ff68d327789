"""Join keypoints and cameras whose image sizes differ: turned, resized or cropped images.

What is stated is applied first. Sizes that still differ are evidence: the intrinsics are changed to
those of images of the size of the keypoint file, and the recording holds this as a fault.
"""

from collections.abc import Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import replace

import numpy as np

from mocap_calib import mapped
from mocap_calib.config import LARGEST_SHARE, TYPICAL_PERCENTILE
from mocap_calib.errors import MismatchError, argument
from mocap_calib.recording.corrections import (
    Cropped,
    Exchanged,
    Refocused,
    Resized,
    Rotated,
    apply_mends,
)
from mocap_calib.recording.far_points import without_far_points
from mocap_calib.recording.names import match_cameras
from mocap_calib.recording.synchronise import make_recording
from mocap_calib.results import Fault, Mend
from mocap_calib.types import Camera, Keypoints2D, Recording, Skeleton

Size = tuple[int, int]

_OF_INTRINSICS = (Exchanged, Rotated, Resized, Cropped, Refocused)
_ROUNDED = 1  # pixel: of an image that was resized to whole (or even) numbers
_BLOCK = 16  # pixels: side of a block of H.264


def join_sized(
    views: Sequence[Keypoints2D],
    cameras: Sequence[Camera],
    skeleton: Skeleton,
    aliases: Mapping[str, str],
    *,
    mends: Sequence[Mend] = (),
    cropped: AbstractSet[str] = frozenset(),
) -> Recording:
    """Return the recording of keypoints and cameras, with intrinsics of images of their sizes.

    mends: what is stated to be wrong with the files; corrections of intrinsics are applied first.
    cropped: names of views whose corner in the whole image is stated.

    Raises MismatchError as `make_recording` does, where sizes contradict what is stated, and where
    keypoints lie beyond an image whose size no file of keypoints states.
    """
    view_of = dict(zip(match_cameras(views, cameras), views, strict=True))
    own = tuple(mend for mend in mends if isinstance(mend, _OF_INTRINSICS))
    sized = [
        replace(each, size=_size_before(view_of[each.name].image_size, each.name, own))
        if each.name in view_of and each.size == (0, 0)
        else each
        for each in cameras
    ]
    recording = apply_mends(make_recording(views, sized, skeleton, aliases), own)
    for camera in recording.cameras:
        view = view_of[camera.name]
        known = view.camera not in cropped
        faults = _compare_sizes(view, camera, view.image_size if known else (0, 0))
        stated = {mend.word for mend in own if mend.camera == camera.name}
        if any(fault.word in stated for fault in faults):
            raise _refuse(view, camera, "leave out what is stated of its images, or correct it")
        recording = _correct(recording, faults, view.image_size)
    return apply_mends(recording, tuple(mend for mend in mends if mend not in own))


def _size_before(size: Size, camera: str, mends: Sequence[Mend]) -> Size:
    """Return the size of images before they were turned and resized as stated."""
    width, height = size
    for mend in reversed(mends):
        if isinstance(mend, Resized) and mend.camera == camera:
            width, height = np.rint((width, height) / mend.factors).astype(int).tolist()
        if isinstance(mend, Rotated) and mend.camera == camera and mend.degrees % 180:
            width, height = height, width
    return width, height


def _correct(recording: Recording, faults: Sequence[Fault], size: Size) -> Recording:
    """Return the recording with the faults of a camera corrected; its images are of a size."""
    if not faults:
        return recording
    mends = (each.mend for each in faults if isinstance(each.mend, _OF_INTRINSICS))
    recording = apply_mends(recording, tuple(mends))
    cameras = tuple(
        replace(each, size=size) if each.name == faults[0].camera and size != (0, 0) else each
        for each in recording.cameras
    )
    return replace(recording, cameras=cameras, corrected=(*recording.corrected, *faults))


def _compare_sizes(view: Keypoints2D, camera: Camera, size: Size) -> tuple[Fault, ...]:
    """Return how images of a size differ from those of the intrinsics, with its correction.

    Where the size of the images is not known, keypoints beyond the image show a quarter turn.
    Raises MismatchError where they lie beyond that, too.
    """
    given = camera.size
    if given == (0, 0) or (size != (0, 0) and _blocks(size) == _blocks(given)):
        return ()
    if size != (0, 0):
        mends = propose_corrections(camera.name, given, size)
        found = f"images of {_text(size)}"
    else:
        x, y = _reach(without_far_points(view, given))
        if x <= LARGEST_SHARE * given[0] and y <= LARGEST_SHARE * given[1]:
            return ()
        if x > LARGEST_SHARE * given[1] or y > LARGEST_SHARE * given[0]:
            factor = argument("resized", f"{camera.name}:FACTOR")
            raise _refuse(view, camera, f"say {factor} if its images were resized")
        mends, found = (Rotated(camera.name, 90),), f"keypoints at ({x:.0f}, {y:.0f})"
    evidence = {"images": found, "intrinsics": _text(given)}
    return tuple(
        Fault(camera.name, mend.word, f"{found}, intrinsics for {_text(given)}", evidence, mend)
        for mend in mends
    )


def propose_corrections(camera: str, given: Size, images: Size) -> tuple[Mend, ...]:
    """Return how intrinsics for images of a size become those for images of another.

    Swapped sides are a quarter turn (whose direction sizes do not show), equal ratios a resize,
    and all else a part of the image; which part is not known, and the middle is taken.
    """
    turned = (given[1], given[0])
    for before, turn in ((given, ()), (turned, (Rotated(camera, 90),))):
        factor = float(np.sqrt(np.prod(images) / np.prod(before)))
        if np.abs(factor * np.array(before) - images).max() <= _ROUNDED:
            return turn if images == before else (*turn, Resized(camera, factor))
    factor = max(float(np.max(np.array(images) / given)), 1.0)
    spare = np.maximum(factor * np.array(given) - images, 0.0)
    x, y = np.round(spare / 2).tolist()
    sigma = float(spare.max() / np.sqrt(12))  # of a corner that may be anywhere
    crop = Cropped(camera, x, y, sigma)
    return (crop,) if factor == 1.0 else (Resized(camera, factor), crop)


def _blocks(size: Size) -> Size:
    """Return the size in whole blocks, by which codecs fill images up at the right and below."""
    return -(-size[0] // _BLOCK), -(-size[1] // _BLOCK)


def _reach(view: Keypoints2D) -> tuple[float, float]:
    """Return how far to the right and down nearly all keypoints of a view lie."""
    some = mapped.some_frames(view.positions)
    x, y = (float(np.nanpercentile(some[..., axis], TYPICAL_PERCENTILE)) for axis in range(2))
    mapped.let_go()
    return x, y


def _refuse(view: Keypoints2D, camera: Camera, remedy: str) -> MismatchError:
    """Return the refusal of images that are not those of a camera."""
    x, y = _reach(view)
    found = _text(view.image_size) if any(view.image_size) else f"keypoints at ({x:.0f}, {y:.0f})"
    expected = f"images of {_text(camera.size)}, as camera {camera.name} has"
    return MismatchError(view.source, expected, found, remedy)


def _text(size: Size) -> str:
    """Return `WIDTH x HEIGHT`."""
    return f"{size[0]} x {size[1]}"
