"""Write keypoint files in a format of `io.keypoints.formats`."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from mocap_calib.io.atomic import check_no_other_files, write_files
from mocap_calib.io.cameras import FILE_NAME, need_names
from mocap_calib.io.format import Format, Written, find_format
from mocap_calib.io.keypoints.formats import KEYPOINT_FORMATS
from mocap_calib.io.keypoints.items import FOLDER_SUFFIXES
from mocap_calib.io.keypoints.losses import require_followed
from mocap_calib.types import Keypoints2D


def format_keypoints(views: tuple[Keypoints2D, ...], format: str) -> Written:
    """Return the files of the cameras in the format, and what of the views they do not hold.

    Raises MismatchError where the format is only read or cannot hold the detections.
    """
    known = find_written_format(format)
    if known.followed:
        for view in views:
            require_followed(view, known.title)
    unsigned = (replace(view, positions=view.positions + 0.0) for view in views)  # no -0.0
    files = known.writer()(tuple(unsigned))
    return Written(files, known.lost(views))


def find_written_format(name: str) -> Format:
    """Return the format of that name. Raises MismatchError where it is not one that is written."""
    known = find_format(KEYPOINT_FORMATS, name)
    known.writer()
    return known


def write_keypoints(
    path: str | Path,
    views: tuple[Keypoints2D, ...],
    format: str,
    *,
    beside: Mapping[str, bytes] | None = None,
) -> tuple[str, ...]:
    """Write the cameras in the format, whole or not at all.

    A format with one file for all cameras writes `path`, where that has an ending; others fill the
    folder `path`. Returns what of the views is not held. Raises MismatchError as `format_keypoints`
    does, and where the folder has files of another recording.

    beside: further files, name -> content, of the folder; beside a file they are called
        FILE.NAME.
    """
    path = Path(path)
    beside = beside or {}
    written = format_keypoints(views, format)
    if len(written.files) == 1 and path.suffix:
        (content,) = written.files.values()
        named = {f"{path.name}.{name}": further for name, further in beside.items()}
        write_files(path.absolute().parent, {path.name: content, **named})
        return written.lost
    for view in views:  # a name may come from inside a file, and lead anywhere
        need_names((view.camera,), *FILE_NAME, view.source)
    check_no_other_files(path, written.files, FOLDER_SUFFIXES)
    write_files(path, {**written.files, **beside})
    return written.lost
