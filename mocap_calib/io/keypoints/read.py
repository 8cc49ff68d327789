"""Read keypoint files of any format of `io.keypoints.formats`."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import groupby
from pathlib import Path

import numpy as np

from mocap_calib import mapped
from mocap_calib.compute.parallel import map_in_threads
from mocap_calib.errors import FormatError, MismatchError, MocapCalibError, argument
from mocap_calib.io.crash_guard import end_calls, guard_hdf5
from mocap_calib.io.document import NAMELESS, Document
from mocap_calib.io.file import check_cameras
from mocap_calib.io.format import find_format, require_format
from mocap_calib.io.keypoints.adjust import apply_offsets, convert_to_pixels, split_views
from mocap_calib.io.keypoints.formats import KEYPOINT_FORMATS
from mocap_calib.io.keypoints.items import keypoint_items, sniff_keypoints
from mocap_calib.io.keypoints.options import ReadOptions
from mocap_calib.io.names import camera_name
from mocap_calib.types import Keypoints2D, Reals

_REMEDY = "export one of these (docs/formats.md)"


def read_keypoints(
    paths: str | Path | bytes | Sequence[str | Path],
    format: str | None = None,
    options: ReadOptions | None = None,
) -> tuple[Keypoints2D, ...]:
    """Read the detections of each camera from files, folders and `name=path` pairs.

    Positions are pixels as the files have them: x to the right, y down.

    paths: one of these, or several, or the content of one file.
    format: name of a keypoint format; where none is given, the content of each file says it.

    Raises FormatError, in one line, for whatever is wrong with a file, and MismatchError where two
    files are of one camera.
    """
    views, errors = read_what_can(paths, format, options)
    if errors:
        raise errors[0]
    return views


def read_what_can(
    paths: str | Path | bytes | Sequence[str | Path],
    format: str | None = None,
    options: ReadOptions | None = None,
) -> tuple[tuple[Keypoints2D, ...], list[MocapCalibError]]:
    """Read the files that can be read; return also what `read_keypoints` raises of the others.

    Raises MismatchError as `read_keypoints` does.
    """
    options = options or ReadOptions()
    if format is not None:
        find_format(KEYPOINT_FORMATS, format)
    if isinstance(paths, bytes):
        items = [Document(Path(NAMELESS), given=paths, camera=NAMELESS)]
    else:
        several = [paths] if isinstance(paths, str | Path) else paths
        items = keypoint_items(several, options, format)
    _check_cameras_once([(item.camera, item.source) for item in items if item.camera])
    views: list[Keypoints2D] = []
    errors: list[MocapCalibError] = []
    try:
        for found in _read_all(items, format, options):
            if isinstance(found, MocapCalibError):
                errors.append(found)
            else:
                views += found
    except BaseException:
        end_calls()  # of threads, which Ctrl-C does not reach
        raise
    _check_cameras_once([(view.camera, view.source) for view in views])
    if errors:
        return tuple(views), errors
    return apply_offsets(views, options), []


def looks_like_keypoints(path: Path) -> bool:
    """Return whether the first file, or folder of frames, at a path is of one of the formats."""
    try:
        first = keypoint_items([path], ReadOptions(), format=None)[0]
        return bool(sniff_keypoints(first).format)
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
        "",
        "one keypoint file per camera",
        f"{files} for camera {twice}",
        "leave one out, or say name=path",
    )


def _read_all(
    items: list[Document], format: str | None, options: ReadOptions
) -> Iterator[tuple[Keypoints2D, ...] | MocapCalibError]:
    """Yield the cameras in each document, or what is wrong with it; the list is empty after.

    HDF5, which other processes read, is read side by side. Any other file is held in memory while
    it is read: one at a time.
    """

    def read(document: Document) -> tuple[Keypoints2D, ...] | MocapCalibError:
        try:
            views = guard_hdf5(document, _read, document, format, options)
            return tuple(map(_keep, views))
        except MocapCalibError as error:
            return error

    waiting = (items.pop(0) for _ in range(len(items)))  # a document holds its file
    for apart, some in groupby(waiting, _is_hdf5):
        if apart:
            yield from map_in_threads(read, some)
        else:
            yield from map(read, some)


def _is_hdf5(document: Document) -> bool:
    """Return whether a document is HDF5, as far as it can be read."""
    try:
        return document.is_hdf5
    except MocapCalibError:
        return False


def _read(document: Document, format: str | None, options: ReadOptions) -> tuple[Keypoints2D, ...]:
    """Read the cameras in a document. Raises FormatError and MismatchError."""
    known = require_format(KEYPOINT_FORMATS, document, format, _REMEDY)
    views = known.reader()(document, options)
    check_cameras([view.camera for view in views], document.source)
    views = _name_camera(views, document)
    if not all(view.camera for view in views):
        raise FormatError(
            document.source,
            f"a camera in the path by the pattern {options.camera_pattern}",
            "none",
            f"change {argument('camera_regex')}",
        )
    read = []
    for view in views:
        for part in split_views(view, options.views):
            scaled = convert_to_pixels(part, options.size_of(part.camera))
            read.append(_in_single_precision(scaled) if options.single_precision else scaled)
    source = document.source
    return tuple(replace(view, camera=camera_name(view.camera, source)) for view in read)


def _name_camera(views: tuple[Keypoints2D, ...], document: Document) -> tuple[Keypoints2D, ...]:
    """Return the views under the name that the user gave to the document, if any.

    Raises MismatchError where that name is given to several cameras.
    """
    if not document.named:
        return views
    if len(views) > 1:
        cameras = ", ".join(view.camera for view in views)
        raise MismatchError(
            document.source,
            f"the one camera {document.camera}",
            cameras,
            "give the file without a name",
        )
    return (replace(views[0], camera=document.camera),)


def _in_single_precision(view: Keypoints2D) -> Keypoints2D:
    """Return the view with positions and confidences of 32 bits, half the memory."""
    return _copy(view, lambda block: block.astype(np.float32))


def _keep(view: Keypoints2D) -> Keypoints2D:
    """Return the view, out of memory where it is long."""
    return _copy(view, lambda block: block)


def _copy(view: Keypoints2D, change: Callable[[Reals], Reals]) -> Keypoints2D:
    """Return the view with what becomes of its arrays, block by block."""

    def changed(array: Reals) -> Reals:
        return mapped.in_blocks(lambda block: change(array[block]), len(array))

    return replace(view, positions=changed(view.positions), confidence=changed(view.confidence))
