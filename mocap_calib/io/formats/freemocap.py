"""FreeMoCap's 2D points: ..._2dData_numCams_numFrames_numTrackedPoints_pixelXY.npy, all cameras.

The array is `[camera, frame, point, 2 or 3]` pixels; a third number is MediaPipe's depth. Traps:
cameras have no names: they come in the order of their videos, as cam_0, cam_1, ... of FreeMoCap's
calibration; frames count from 0; points have neither names nor scores. 553 points are those of
MediaPipe: body, right hand, left hand, face. One person.
"""

import io
from collections.abc import Sequence

import numpy as np

from mocap_calib.errors import one_line
from mocap_calib.io.detections import check_cameras, check_size, make_view
from mocap_calib.io.document import Document
from mocap_calib.io.file import Origin
from mocap_calib.io.format import Format
from mocap_calib.io.read_options import ReadOptions, choose_layout
from mocap_calib.types import Floats, Keypoints2D

_MAGIC = b"\x93NUMPY"
_AXES = 4
_LAYOUTS = ("blazepose_33", "freemocap_553", "freemocap_75")
REMARK = "cameras are cam_0, cam_1, ... in the order of their videos"


def sniff(document: Document) -> bool:
    """Return whether this is an array file of numpy."""
    return not document.is_folder and document.start.startswith(_MAGIC)


def read(document: Document, options: ReadOptions) -> tuple[Keypoints2D, ...]:
    """Read all cameras. Raises FormatError."""
    points = _load(document)
    cameras, frames, count = points.shape[:3]
    check_size(frames, 1, count, document.source)
    names = choose_layout(count, options.layout, document.source, _LAYOUTS)
    labels = [f"cam_{camera}" for camera in range(cameras)]
    check_cameras(labels, document.source)
    return tuple(
        _view(document, label, names, of_camera)
        for label, of_camera in zip(labels, points, strict=True)
    )


def _view(document: Document, camera: str, names: Sequence[str], points: Floats) -> Keypoints2D:
    """Return a camera of `[frame, point, 2 or 3]`."""
    values = np.full((len(points), 1, len(names), 3), np.nan)
    values[:, 0, :, :2] = points[..., :2]
    origin = Origin(camera, document.source)
    return make_view(origin, names, range(len(points)), values, tracked=True, remarks=(REMARK,))


def _load(document: Document) -> Floats:
    """Return the array. Raises FormatError."""
    expected = "an array [camera, frame, point, 2 or 3] of pixels"
    try:
        array = np.load(io.BytesIO(document.content), allow_pickle=False)
    except Exception as error:  # numpy raises whatever damage of the header leads to
        raise document.refuse(expected, f"an error ({one_line(error)})") from None
    if array.ndim != _AXES or array.shape[-1] not in (2, 3) or array.dtype.kind not in "fiu":
        raise document.refuse(expected, f"{array.shape} of {array.dtype}")
    return array.astype(np.float64)


FORMAT = Format(
    name="freemocap-2d",
    title="FreeMoCap 2D .npy",
    sniff=sniff,
    read=read,
)
