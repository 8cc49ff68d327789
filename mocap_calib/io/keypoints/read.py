"""Read keypoint files of any format of `io.keypoints.formats`."""

from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from mocap_calib.errors import FormatError, MismatchError, MocapCalibError
from mocap_calib.io.file import check_cameras, malformed
from mocap_calib.io.keypoints.adjust import apply_offsets, in_pixels, split_views
from mocap_calib.io.keypoints.document import Document, Item, ReadOptions, describe
from mocap_calib.io.keypoints.formats import KEYPOINT_FORMATS, KeypointFormat
from mocap_calib.io.keypoints.items import Holds, keypoint_items
from mocap_calib.io.registry import find_format, format_names
from mocap_calib.io.sandbox import call_contained
from mocap_calib.types import Keypoints2D


def read_keypoints(
    paths: Sequence[str | Path], format: str | None = None, options: ReadOptions | None = None
) -> tuple[Keypoints2D, ...]:
    """Read the detections of each camera from files, folders and `name=path` pairs.

    Positions are pixels as the files have them: x to the right, y down.

    format: name of a keypoint format; where none is given, the content of each file says it.

    Raises FormatError, in one line, for whatever is wrong with a file, and MismatchError where two
    files are of one camera.
    """
    views, errors = read_what_can(paths, format, options)
    if errors:
        raise errors[0]
    return views


def read_what_can(
    paths: Sequence[str | Path],
    format: str | None = None,
    options: ReadOptions | None = None,
) -> tuple[tuple[Keypoints2D, ...], list[MocapCalibError]]:
    """Read the files that can be read; return also what `read_keypoints` raises of the others.

    Raises MismatchError as `read_keypoints` does.
    """
    options = options or ReadOptions()
    if format is not None:
        find_format(KEYPOINT_FORMATS, format)
    waiting = deque(keypoint_items(paths, options, lambda item: _look(item, format)))
    _check_cameras_once([(item.camera, str(item.path)) for item in waiting if item.camera])
    views: list[Keypoints2D] = []
    errors: list[MocapCalibError] = []
    while waiting:
        item = waiting.popleft()  # which holds its file: one at a time
        try:
            views += _read_contained(item, format, options)
        except MocapCalibError as error:
            errors.append(error)
    _check_cameras_once([(view.camera, view.source) for view in views])
    if errors:
        return tuple(views), errors
    return apply_offsets(views, options), []


def looks_like_keypoints(path: Path) -> bool:
    """Return whether the first file, or folder of frames, at a path is of one of the formats."""
    try:
        items = keypoint_items([path], ReadOptions(), lambda item: _look(item, None))
        return _sniff_contained(items[0], None) != ""
    except MocapCalibError:
        return False


def _check_cameras_once(found: list[tuple[str, str]]) -> None:
    """Raise MismatchError where a camera occurs twice in (camera, source) pairs."""
    cameras = [camera for camera, _ in found]
    twice = next((camera for camera in cameras if cameras.count(camera) > 1), None)
    if twice is None:
        return
    files = " and ".join(source for camera, source in found if camera == twice)
    raise MismatchError(
        f"expected one keypoint file per camera, found {files} for camera {twice}; "
        "leave one out, or say name=path"
    )


def _look(item: Item, format: str | None) -> Holds:
    """Return what a file shows of itself; a damaged one is complained of when it is read."""
    try:
        found = _sniff_contained(item, format)
    except FormatError:
        return Holds.A_CAMERA
    if not found:
        return Holds.NOTHING
    per_frame = find_format(KEYPOINT_FORMATS, found).per_frame
    return Holds.A_FRAME if per_frame else Holds.A_CAMERA


def _sniff_contained(item: Item, format: str | None) -> str:
    """`_sniff` an item; HDF5 in a process of its own."""
    document = item.document
    return call_contained(document.content, str(item.path), _sniff, document, format)


def _read_contained(
    item: Item, format: str | None, options: ReadOptions
) -> tuple[Keypoints2D, ...]:
    """`_read` an item; HDF5 in a process of its own."""
    return call_contained(item.document.content, str(item.path), _read, item, format, options)


def _sniff(document: Document, format: str | None) -> str:
    """Return the name of the format that the content shows, "" where it shows none.

    Only `format` is tried where it is given. Raises FormatError where the content is damaged.
    """
    for each in KEYPOINT_FORMATS:
        if format in (None, each.name) and each.sniff(document):
            return each.name
    return ""


def _find_format(document: Document, format: str | None) -> KeypointFormat:
    """Return the format that is named, or that the content shows.

    Raises FormatError, also where the content cannot be what is named.
    """
    name = _sniff(document, format)
    if name:
        return find_format(KEYPOINT_FORMATS, name)
    found, remedy = describe(document)
    if format is not None:
        expected = find_format(KEYPOINT_FORMATS, format).title
        remedy = remedy or "name another format, or none"
    else:
        expected = f"one of: {', '.join(format_names(KEYPOINT_FORMATS))}"
        remedy = remedy or "export one of these"
    raise malformed(document.source, expected, found, remedy)


def _read(item: Item, format: str | None, options: ReadOptions) -> tuple[Keypoints2D, ...]:
    """Read the cameras in one item. Raises FormatError and MismatchError."""
    views = _find_format(item.document, format).read(item, options)
    check_cameras([view.camera for view in views], str(item.path))
    views = _name_camera(views, item)
    if not all(view.camera for view in views):
        raise malformed(
            str(item.path),
            f"a camera in the path by the pattern {options.camera_pattern}",
            "none",
            "change --camera-regex",
        )
    read = []
    for view in views:
        for part in split_views(view, options.views):
            found = in_pixels(part, options.image_size)
            read.append(_in_single_precision(found) if options.single_precision else found)
    return tuple(read)


def _name_camera(views: tuple[Keypoints2D, ...], item: Item) -> tuple[Keypoints2D, ...]:
    """Return the views under the name that the user gave to the item, if any.

    Raises MismatchError where that name is given to several cameras.
    """
    if not item.named:
        return views
    if len(views) > 1:
        cameras = ", ".join(view.camera for view in views)
        raise MismatchError(
            f"{item.path}: expected the one camera {item.camera}, found {cameras}; "
            "give the file without a name"
        )
    return (replace(views[0], camera=item.camera),)


def _in_single_precision(view: Keypoints2D) -> Keypoints2D:
    return replace(
        view,
        positions=view.positions.astype(np.float32),
        confidence=view.confidence.astype(np.float32),
    )
