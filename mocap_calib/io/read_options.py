"""What the user states of keypoint files that do not say it themselves, and its effect on them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from importlib import resources
from typing import TypeVar

import numpy as np

from mocap_calib.config import LARGEST_SHARE, LEAST_SHARE
from mocap_calib.errors import FormatError, MismatchError, argument, one_line, suggest
from mocap_calib.io.file import LARGEST_FRAME
from mocap_calib.recording.names import compose_name, find_names
from mocap_calib.types import Keypoints2D

T = TypeVar("T")


@dataclass(frozen=True)
class ReadOptions:
    """What a file does not say itself.

    layout: names of the keypoints, in the file's order.
    image_size: (width, height) in pixels, where the file has none; positions that are shares of
        the image are multiplied by it. image_sizes: camera -> its own.
    camera_pattern: regular expression that finds the camera's name in a path (its group `camera`,
        or its first group, or all of it), and perhaps the frame number (group `frame`).
    frame_offset: camera -> added to its frame numbers.
    crop_offset: camera -> (x, y) in pixels added to its positions; the size of the whole image is
        then `image_size`, whatever the file has.
    views: suffixes of keypoint names that stand for views (`paw_top`, `paw_bot`), each of which
        becomes a camera.
    single_precision: keep float32, a ten-thousandth of a pixel, of each file: long recordings need
        half the memory.
    """

    layout: tuple[str, ...] = ()
    image_size: tuple[int, int] = (0, 0)
    camera_pattern: str = ""
    frame_offset: Mapping[str, int] = field(default_factory=dict)
    crop_offset: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    views: tuple[str, ...] = ()
    single_precision: bool = False
    image_sizes: Mapping[str, tuple[int, int]] = field(default_factory=dict)

    def cropped(self, views: Sequence[Keypoints2D]) -> frozenset[str]:
        """Return the names of the views whose keypoints were found in a part of the image."""
        return frozenset(_by_view(self.crop_offset, [view.camera for view in views]))

    def size_of(self, camera: str) -> tuple[int, int]:
        """Return the size of the images of a camera, (0, 0) where the user does not say."""
        sizes = {compose_name(name): size for name, size in self.image_sizes.items()}
        return sizes.get(compose_name(camera), self.image_size)


def split_views(view: Keypoints2D, suffixes: tuple[str, ...]) -> tuple[Keypoints2D, ...]:
    """Return the cameras of a file whose keypoint names end in the view (`paw_top`, `paw_bot`).

    Each camera is called by its suffix. Raises MismatchError where a keypoint has none of the
    suffixes.
    """
    if not suffixes:
        return (view,)
    indices_of: dict[str, list[int]] = {}
    for index, name in enumerate(view.keypoints):
        suffix = next((each for each in suffixes if name.endswith(f"_{each}")), None)
        if suffix is None:
            expected = f"every keypoint to end in _{' or _'.join(suffixes)}"
            raise MismatchError(view.source, expected, name, f"change {argument('views')}")
        indices_of.setdefault(suffix, []).append(index)
    return tuple(
        replace(
            view,
            camera=suffix,
            keypoints=tuple(view.keypoints[index].removesuffix(f"_{suffix}") for index in indices),
            positions=view.positions[:, :, indices],
            confidence=view.confidence[:, :, indices],
        )
        for suffix, indices in indices_of.items()
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
    if view.image_size not in ((0, 0), size):
        expected = "images of {}x{}, as the file says".format(*view.image_size)
        given = argument("image_size", "{}x{}".format(*size))
        raise MismatchError(view.source, expected, given, "change it")
    least = np.nanmin(view.positions, initial=0.0)
    if least < LEAST_SHARE:
        expected = "pixels, or shares of the image from 0 to 1"
        raise MismatchError(view.source, expected, f"{least:.2f}", "export pixels")
    scale = np.array(size, dtype=view.positions.dtype)
    return replace(view, positions=view.positions * scale, image_size=size)


def apply_offsets(views: Sequence[Keypoints2D], options: ReadOptions) -> tuple[Keypoints2D, ...]:
    """Return the views with the user's offsets of frames and pixels.

    Raises MismatchError for offsets, and image sizes, of cameras that are not there.
    """
    known = [view.camera for view in views]
    frame_offset = _by_view(options.frame_offset, known)
    crop_offset = _by_view(options.crop_offset, known)
    for camera in options.image_sizes:
        if compose_name(camera) not in known:
            raise _no_such_view(camera, known, "image sizes")
    whole = (
        replace(view, image_size=options.size_of(view.camera))
        if view.camera in crop_offset
        else view
        for view in views
    )
    return tuple(
        _apply_offset(
            view, frame_offset.get(view.camera, 0), crop_offset.get(view.camera, (0.0, 0.0))
        )
        for view in whole
    )


def _no_such_view(camera: str, known: Sequence[str], what: str) -> MismatchError:
    """Return the refusal of what is given of a camera that no view is of."""
    expected = f"{what} of the cameras {', '.join(sorted(known))}"
    return MismatchError("", expected, f"one of {camera}", "change its name")


def _by_view(given: Mapping[str, T], known: Sequence[str]) -> dict[str, T]:
    """Return what is given by camera by the name of its view, see `find_names`.

    Raises MismatchError for cameras that no view is of.
    """
    names = list(map(compose_name, given))
    of_view = find_names(known, names) if known else []
    found = {
        view: given[list(given)[names.index(each[0])]]
        for view, each in zip(known, of_view, strict=True)
        if len(each) == 1
    }
    for camera in names:
        if not any(camera in each for each in of_view):
            raise _no_such_view(camera, known, "offsets")
    return found


def _apply_offset(view: Keypoints2D, frames: int, pixels: tuple[float, float]) -> Keypoints2D:
    """Return the view with these numbers added to its frame numbers and to its positions."""
    if not len(view.frames) or (not frames and pixels == (0.0, 0.0)):
        return view
    first, last = int(view.frames[0]) + frames, int(view.frames[-1]) + frames
    if first < 0 or last >= LARGEST_FRAME:
        found, remedy = f"{first} after the offset", f"change {argument('frame_offset')}"
        raise MismatchError(view.source, "frame numbers from 0 on", found, remedy)
    return replace(view, frames=view.frames + frames, positions=view.positions + np.array(pixels))


# --- layouts


@cache
def layouts() -> dict[str, tuple[str, ...]]:
    """Return the names of keypoints in the orders in which programs write them, by layout."""
    import tomllib  # noqa: PLC0415 - most files name their keypoints

    text = (resources.files("mocap_calib") / "io" / "layouts.toml").read_text("utf-8")
    return {name: tuple(names.split()) for name, names in tomllib.loads(text).items()}


def parse_layout(text: str) -> tuple[str, ...]:
    """Return the names of a layout, or names separated by commas. Raises MismatchError."""
    if text in layouts():
        return layouts()[text]
    names = tuple(name.strip() for name in text.split(","))
    if len(names) < 2 or not all(names):
        known = f"a layout ({', '.join(layouts())})"
        expected = f"{known} or names of keypoints separated by commas"
        raise MismatchError("", expected, one_line(text, 200), suggest(text, layouts()))
    return names


def choose_layout(
    count: int, given: Sequence[str], source: str, unambiguous: Sequence[str] = ()
) -> tuple[str, ...]:
    """Return the names of `count` keypoints.

    given: the names that the user or the file gives; they are taken where there are any.
    unambiguous: layouts that are the program's only ones of their length; else the one of these
        that has as many names is taken.

    Two layouts of one length differ in their order: which one it is, is never guessed.
    Raises FormatError.
    """
    if given and len(given) != count:
        expected = f"{len(given)} keypoints, as many as the layout has"
        remedy = f"give {argument('layout')} with as many names as the file has keypoints"
        raise FormatError(source, expected, count, remedy)
    fitting = [layouts()[name] for name in unambiguous if len(layouts()[name]) == count]
    if not given and len(fitting) != 1:
        expected, remedy = f"the names of its {count} keypoints", layout_remedy([count])
        raise FormatError(source, expected, "numbers alone", remedy)
    return tuple(given) or fitting[0]


def layout_remedy(counts: Sequence[float]) -> str:
    """Return what to do about a file that needs a layout of one of these lengths."""
    fitting = [name for name, names in layouts().items() if len(names) in counts]
    if fitting:
        return f"give {argument('layout')} ({' or '.join(fitting)})"
    return f"give {argument('layout')} with names separated by commas"
