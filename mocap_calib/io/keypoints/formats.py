"""The table of keypoint formats: how each is recognised by content, read and written."""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mocap_calib.errors import FormatError, MismatchError, MocapCalibError
from mocap_calib.io.atomic import check_alone, folder, write_bytes
from mocap_calib.io.cameras.source import FILE_NAME, need_names
from mocap_calib.io.file import check_cameras, malformed
from mocap_calib.io.keypoints import (
    caliscope,
    coco,
    coco_writer,
    deeplabcut_csv,
    deeplabcut_h5,
    deeplabcut_writer,
    generic_csv,
    label3d,
    mmpose,
    nwb,
    openpose,
    sleap_csv,
    sleap_h5,
    sleap_slp,
    superanimal,
    ultralytics,
)
from mocap_calib.io.keypoints import flat_json as results_json
from mocap_calib.io.keypoints import movement as movement_nc
from mocap_calib.io.keypoints.adjust import apply_offsets, in_pixels, split_views
from mocap_calib.io.keypoints.document import Document, Item, ReadOptions, describe
from mocap_calib.io.keypoints.items import FOLDER_SUFFIXES, Holds, keypoint_items
from mocap_calib.io.keypoints.losses import FOLLOWED, GAPS, MIXED, NAMES, SCORES, SIZES, Loss
from mocap_calib.io.sandbox import contained
from mocap_calib.types import Keypoints2D

Writer = Callable[[tuple[Keypoints2D, ...]], dict[str, bytes]]


@dataclass(frozen=True)
class KeypointFormat:
    """One format.

    sniff: whether a file is meant for it, which its reader may still refuse. read: the cameras in a file or folder.
    write: relative path -> content of what holds these cameras, or None. per_frame: a file holds one frame, a folder
    one camera. ending: of the files that are written. lacks: what a written file has no place for.
    """

    description: str
    sniff: Callable[[Document], bool]
    read: Callable[[Item, ReadOptions], tuple[Keypoints2D, ...]]
    write: Writer | None = None
    per_frame: bool = False
    ending: str = ""
    lacks: tuple[Loss, ...] = ()


# the first whose sniff says yes reads the file
KEYPOINT_FORMATS = {
    "coco": KeypointFormat(
        "COCO annotations .json",
        coco.sniff,
        coco.read,
        coco_writer.write,
        ending=".json",
        lacks=(FOLLOWED, SCORES),
    ),
    "openpose": KeypointFormat(
        "OpenPose .json, a folder per camera",
        openpose.sniff,
        openpose.read,
        openpose.write,
        per_frame=True,
        ending=".json",
        lacks=(NAMES, FOLLOWED, SIZES, SCORES),
    ),
    "mmpose-images": KeypointFormat(
        "MMPose .json of images, a folder per camera",
        mmpose.sniff_image,
        mmpose.read_images,
        per_frame=True,
    ),
    "mmpose": KeypointFormat(
        "MMPose and RTMPose .json of a video", mmpose.sniff_video, mmpose.read_video
    ),
    "superanimal": KeypointFormat(
        "DeepLabCut SuperAnimal .json", superanimal.sniff, superanimal.read
    ),
    "coco-results": KeypointFormat(
        "COCO results .json", results_json.sniff_coco, results_json.read_coco
    ),
    "alphapose": KeypointFormat(
        "AlphaPose .json", results_json.sniff_alphapose, results_json.read_alphapose
    ),
    "deeplabcut-h5": KeypointFormat(
        "DeepLabCut .h5",
        deeplabcut_h5.sniff,
        deeplabcut_h5.read,
        deeplabcut_writer.write_h5,
        ending=".h5",
        lacks=(SIZES, SCORES),
    ),
    "sleap": KeypointFormat(
        "SLEAP analysis .h5",
        sleap_h5.sniff,
        sleap_h5.read,
        sleap_h5.write,
        ending=".h5",
        lacks=(SIZES, GAPS, SCORES),
    ),
    "sleap-slp": KeypointFormat("SLEAP .slp", sleap_slp.sniff, sleap_slp.read),
    "movement": KeypointFormat(
        "movement .nc",
        movement_nc.sniff,
        movement_nc.read,
        movement_nc.write,
        ending=".nc",
        lacks=(SIZES, SCORES),
    ),
    "nwb": KeypointFormat("NWB ndx-pose .nwb", nwb.sniff, nwb.read),
    "label3d": KeypointFormat("Label3D .mat", label3d.sniff, label3d.read),
    "deeplabcut-csv": KeypointFormat(
        "DeepLabCut and Lightning Pose .csv",
        deeplabcut_csv.sniff,
        deeplabcut_csv.read,
        deeplabcut_writer.write_csv,
        ending=".csv",
        lacks=(SIZES, SCORES),
    ),
    "sleap-csv": KeypointFormat("SLEAP analysis .csv", sleap_csv.sniff, sleap_csv.read),
    "caliscope": KeypointFormat("caliscope .csv", caliscope.sniff, caliscope.read),
    "csv": KeypointFormat(
        "csv with a row per point (camera,frame,individual,keypoint,x,y,score)",
        generic_csv.sniff,
        generic_csv.read,
        generic_csv.write,
        ending=".csv",
        lacks=(MIXED, SIZES, SCORES),
    ),
    "ultralytics": KeypointFormat(
        "Ultralytics .txt, a folder per camera", ultralytics.sniff, ultralytics.read, per_frame=True
    ),
}


def read_keypoints(
    paths: Sequence[str | Path], format: str | None = None, options: ReadOptions | None = None
) -> tuple[Keypoints2D, ...]:
    """The detections of each camera in files, folders and `name=path` pairs; x right, y down, in pixels as the files have them.

    format: a name in KEYPOINT_FORMATS; each file's content says where none is given. Raises FormatError, in one line,
    for whatever is wrong with a file, and MismatchError where two files are of one camera.
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
    """The detections of the files that can be read, and what `read_keypoints` would raise of the others. Raises MismatchError as it does."""
    options = options or ReadOptions()
    if format is not None:
        _known(format)
    waiting = deque(keypoint_items(paths, options, lambda item: _holds(item, format)))
    _check_once([(item.camera, str(item.path)) for item in waiting if item.camera])
    views: list[Keypoints2D] = []
    errors: list[MocapCalibError] = []
    while waiting:
        item = waiting.popleft()  # which holds its file: one at a time
        try:
            views += contained(item.document.content, str(item.path), _read, item, format, options)
        except MocapCalibError as error:
            errors.append(error)
    _check_once([(view.camera, view.source) for view in views])
    return (tuple(views) if errors else apply_offsets(views, options)), errors


def looks_like_keypoints(path: Path) -> bool:
    """Whether the first file, or folder of frames, in a file or folder is of one of the formats."""
    try:
        item = keypoint_items([path], ReadOptions(), lambda item: _holds(item, None))[0]
        return contained(item.document.content, str(item.path), _sniffed, item.document, None) != ""
    except MocapCalibError:
        return False


def _lean(view: Keypoints2D) -> Keypoints2D:
    """The same in single precision."""
    return replace(
        view,
        positions=view.positions.astype(np.float32),
        confidence=view.confidence.astype(np.float32),
    )


def _check_once(found: list[tuple[str, str]]) -> None:
    """Holds (camera, source) pairs to one of each camera. Raises MismatchError."""
    cameras = [camera for camera, _ in found]
    twice = next((camera for camera in cameras if cameras.count(camera) > 1), None)
    if twice is not None:
        files = " and ".join(source for camera, source in found if camera == twice)
        raise MismatchError(
            f"expected one keypoint file per camera, found {files} for camera {twice}; leave one out, or say name=path"
        )


def write_keypoints(path: Path, views: tuple[Keypoints2D, ...], format: str) -> tuple[str, ...]:
    """Writes the cameras as `format` has them, whole or not at all, and returns what of the views it does not hold.

    A format with one file for all of them writes `path`; others fill the folder `path`. Raises MismatchError where the
    format has no writer or cannot hold the detections, and where the folder has files of another recording.
    """
    known_format = _known(format)
    if known_format.write is None:
        known = ", ".join(name for name, each in KEYPOINT_FORMATS.items() if each.write)
        raise MismatchError(
            f"expected a keypoint format that is written ({known}), found {format}; choose one of those"
        )
    files = known_format.write(views)
    lost = tuple(loss.what for loss in known_format.lacks if loss.has(views))
    if len(files) == 1 and path.suffix:
        write_bytes(path, next(iter(files.values())))
        return lost
    for view in views:
        need_names(
            (view.camera,), *FILE_NAME, view.source
        )  # it may come from inside a file, and lead anywhere
    check_alone(path, files, FOLDER_SUFFIXES)
    with folder(path) as work:
        for name, content in files.items():
            (work / name).parent.mkdir(parents=True, exist_ok=True)
            (work / name).write_bytes(content)
    return lost


def _known(name: str) -> KeypointFormat:
    if name not in KEYPOINT_FORMATS:
        raise MismatchError(
            f"expected a keypoint format ({', '.join(KEYPOINT_FORMATS)}), found {name}; choose one of those"
        )
    return KEYPOINT_FORMATS[name]


def _sniffed(document: Document, name: str | None) -> str:
    """The format that is named, or that the content shows; "" where it shows none. Raises FormatError where it is damaged."""
    return next(
        (
            known
            for known in ([name] if name else KEYPOINT_FORMATS)
            if KEYPOINT_FORMATS[known].sniff(document)
        ),
        "",
    )


def _format(document: Document, name: str | None) -> KeypointFormat:
    """The format that is named, or that the content shows. Raises FormatError, also where the content cannot be what is named."""
    known = _sniffed(document, name)
    if known:
        return KEYPOINT_FORMATS[known]
    found, remedy = describe(document)
    if name is not None:
        raise malformed(
            document.source,
            KEYPOINT_FORMATS[name].description,
            found,
            remedy or "name another format, or none",
        )
    raise malformed(
        document.source,
        f"one of: {', '.join(KEYPOINT_FORMATS)}",
        found,
        remedy or "export one of these",
    )


def _holds(item: Item, name: str | None) -> Holds:
    """What the first file of a folder says of it; a damaged one is complained of when it is read."""
    try:
        found = contained(item.document.content, str(item.path), _sniffed, item.document, name)
    except FormatError:
        return Holds.A_CAMERA
    if not found:
        return Holds.NOTHING
    return Holds.A_FRAME if KEYPOINT_FORMATS[found].per_frame else Holds.A_CAMERA


def _read(item: Item, name: str | None, options: ReadOptions) -> tuple[Keypoints2D, ...]:
    """The cameras in one item. Raises FormatError and MismatchError."""
    views = _format(item.document, name).read(item, options)
    check_cameras([view.camera for view in views], str(item.path))
    if item.named and len(views) > 1:
        cameras = ", ".join(view.camera for view in views)
        raise MismatchError(
            f"{item.path}: expected the one camera {item.camera}, found {cameras}; give the file without a name"
        )
    if item.named:
        views = (replace(views[0], camera=item.camera),)
    if not all(view.camera for view in views):
        raise malformed(
            str(item.path),
            f"a camera in the path by the pattern {options.camera_pattern}",
            "none",
            "change --camera-regex",
        )
    split = (
        in_pixels(view, options.image_size)
        for whole in views
        for view in split_views(whole, options.views)
    )
    return tuple(map(_lean, split)) if options.single_precision else tuple(split)
