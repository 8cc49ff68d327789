"""DLTdv's and Argus' digitised points, and the DLT coefficients of DLTdv, Argus and easyWand.

* xypts.csv has a row per frame, without frame numbers, and the columns of all cameras.
  DLTdv 8 heads them `<point>_cam1_U, <point>_cam1_V`: v points down, and the centre of the first
  pixel is at 1. DLTdv 5 to 7, and scripts, head them `pt1_cam1_X, pt1_cam1_Y`; in DLTdv's own files
  y points up. Argus heads them `<track>_cam_1_x`, and y points up from the bottom of the image.
* DLT coefficients: a table of 11 rows and a column a camera, without names, sizes and distortion.
  u = (L1 X + L2 Y + L3 Z + L4) / (L9 X + L10 Y + L11 Z + 1), v likewise with L5 to L8. Where v
  points up (DLTdv 7 and below, Argus), they are the coefficients of mirrored images.
* easyWand saves the coefficients in a MATLAB struct, `easyWandData.coefs`.
"""

import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from mocap_calib.errors import FormatError, argument
from mocap_calib.io.cameras import (
    CameraFile,
    RawCamera,
    cannot,
    check_rig,
    collect_cameras,
    skew_in_pixels,
)
from mocap_calib.io.document import Document
from mocap_calib.io.format import Format, Written
from mocap_calib.io.formats.dannce import read_mat
from mocap_calib.io.formats.wide_tables import Header, views_of_columns
from mocap_calib.io.read_options import ReadOptions
from mocap_calib.io.units import ARBITRARY
from mocap_calib.types import CameraRig, Floats, Keypoints2D

_LABEL = re.compile(r"(?P<name>.+)_(?P<camera>cam(?P<argus>_)?[0-9]+)_(?P<part>[XYUVxy])")
_PARTS = {"X": "x", "Y": "y", "U": "x", "V": "y"}
_FIRST_PIXEL = 1.0  # where MATLAB has the centre of the first pixel
_COEFFICIENTS = 11
_STRUCT = "easyWandData"
_NUMBERS = re.compile(r"\s*[-+.0-9eE]+(\s*[,\t ]\s*[-+.0-9eE]+)*\s*")
_SEEN = 0.05  # pixels, below which nobody sees a skew
_AT_ORIGIN = 1e-9  # of the lengths of a rig
AS_IN_FILE = "y is taken to point down, as in DLTdv 8; in files of DLTdv 5 to 7 it points up"
NO_LENS = "DLT coefficients have no distortion: they are of undistorted pixels"


# --- points


def sniff_points(document: Document) -> bool:
    """Return whether all headings are a point, a camera and a coordinate."""
    return len(document.header) > 1 and all(map(_LABEL.fullmatch, document.header))


def read_points(document: Document, options: ReadOptions) -> tuple[Keypoints2D, ...]:
    """Read all cameras, in pixels from the top left. Raises FormatError."""
    labels = [found for found in map(_LABEL.fullmatch, document.header) if found]
    columns: dict[tuple[str, str], dict[str, int]] = {}
    for place, label in enumerate(labels):
        parts = columns.setdefault((label["camera"].replace("_", ""), label["name"]), {})
        parts[_PARTS[label["part"].upper()]] = place
    if single := [name for (_, name), parts in columns.items() if len(parts) < 2]:
        raise document.refuse("two columns of each point", f"one of {single[0]}")
    views = views_of_columns(document, Header(document.header), columns)
    if "U" in {label["part"] for label in labels}:
        return tuple(replace(view, positions=view.positions - _FIRST_PIXEL) for view in views)
    if not all(label["argus"] for label in labels):
        return tuple(replace(view, remarks=(*view.remarks, AS_IN_FILE)) for view in views)
    return tuple(_upside_down(view, document, options) for view in views)


def _upside_down(view: Keypoints2D, document: Document, options: ReadOptions) -> Keypoints2D:
    """Return the points of Argus with y from the top. Raises FormatError."""
    size = options.size_of(view.camera)
    if size == (0, 0):
        expected = "the size of the images, from whose bottom y counts"
        raise document.refuse(expected, "none", f"say {argument('image_size', 'WIDTHxHEIGHT')}")
    positions = np.array([0.0, size[1]]) + view.positions * [1.0, -1.0]
    return replace(view, positions=positions, image_size=size)


# --- coefficients


def sniff_coefficients(document: Document) -> bool:
    """Return whether this is a table of 11 rows of numbers, or easyWand's struct."""
    if document.is_folder:
        return False
    if document.start.startswith(b"MATLAB"):
        return _STRUCT in read_mat(document, (_STRUCT,))
    lines = [line for line in document.head.splitlines() if line.strip()]
    return len(lines) == _COEFFICIENTS and all(map(_NUMBERS.fullmatch, lines))


def read_coefficients(document: Document) -> CameraFile:
    """Read the cameras cam1, cam2, ... Raises FormatError."""
    if document.start.startswith(b"MATLAB"):
        found = read_mat(document, (_STRUCT,)).get(_STRUCT)
        values = found[0].get("coefs") if isinstance(found, list) and found else None
    else:
        rows = [re.split(r"[,\t ]+", line.strip()) for line in document.text.splitlines()]
        values = [row for row in rows if row != [""]]
    try:
        table = np.array(values, dtype=np.float64)
    except (ValueError, TypeError):
        table = np.empty(0)
    if table.ndim != 2 or len(table) != _COEFFICIENTS or not np.isfinite(table).all():
        raise document.refuse("a column of 11 DLT coefficients for each camera", "another table")
    ones = np.ones((1, table.shape[1]))
    projections = np.concatenate([table, ones]).T.reshape(-1, 3, 4)
    with np.errstate(all="ignore"):  # coefficients of a damaged file
        signs = np.sign(np.linalg.det(projections[:, :, :3]))
    if not (signs > 0).any():
        expected = "coefficients of images whose v points down, as of DLTdv 8"
        remedy = "flip them (DLTdv 8: Flip DLT coefficients)"
        raise document.refuse(expected, "those of mirrored images (DLTdv 7 and below)", remedy)
    raws, notes = [], [NO_LENS]
    for number, (sign, projection) in enumerate(zip(signs, projections, strict=True), start=1):
        raw, skew = _decompose(sign * projection, f"cam{number}", document.source)
        raws.append(raw)
        if skew:
            notes.append(f"cam{number}: a skew that moves pixels by up to {skew:.2g} is left out")
    return collect_cameras(raws, document.source, notes=notes)


def _decompose(projection: Floats, name: str, source: str) -> tuple[RawCamera, float]:
    """Return the camera of a `[3, 4]` projection, and by how much its skew moves pixels.

    The sign of the projection is that of points before the camera. Raises FormatError.
    """
    from scipy.linalg import rq  # noqa: PLC0415 - takes 0.2 s

    matrix, rotation = rq(projection[:, :3])
    signs = np.where(np.diag(matrix) < 0, -1.0, 1.0)
    matrix, rotation = matrix * signs, signs[:, None] * rotation
    with np.errstate(all="ignore"):  # coefficients of a damaged file
        translation = np.linalg.lstsq(matrix, projection[:, 3], rcond=None)[0]
        matrix = matrix / matrix[2, 2]
    if not np.isfinite(matrix).all() or np.linalg.det(rotation) < 0:
        raise FormatError(source, f"DLT coefficients of {name}", "others", "export them again")
    moved = skew_in_pixels(matrix)
    matrix = matrix * [[1, 0, 1], [0, 1, 1], [0, 0, 1]]
    matrix[2] = [0, 0, 1]
    raw = RawCamera(
        name=name, matrix=matrix, distortion=(), rotation=rotation, translation=translation
    )
    return raw, moved if moved > _SEEN else 0.0


def write_coefficients(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:
    """Write the coefficients, of images whose v points down. Raises MismatchError."""
    lost = check_rig(rig, provenance, "dlt", terms=0, sizes="lost", verdict=False)
    columns = []
    for camera in rig:
        extrinsics = np.column_stack([camera.rotation, camera.translation])
        projection = camera.matrix @ extrinsics
        if abs(projection[2, 3]) < _AT_ORIGIN:
            raise cannot("dlt", camera.name, "a camera away from the origin", "one at its depth")
        columns.append((projection / projection[2, 3]).ravel()[:_COEFFICIENTS].tolist())
    lines = (",".join(map(repr, row)) for row in zip(*columns, strict=True))
    numbered = tuple(f"cam{number}" for number in range(1, len(rig.cameras) + 1))
    names = () if rig.names == numbered else ("the cameras' names: they are cam1, cam2, ...",)
    unit = ("the unit of length",) if rig.unit != ARBITRARY else ()
    return Written({"dltcoefs.csv": "\n".join([*lines, ""]).encode()}, (*unit, *names, *lost))


POINTS = Format(
    name="dltdv",
    title="DLTdv or Argus xypts.csv",
    sniff=sniff_points,
    read=read_points,
)
COEFFICIENTS = Format(
    name="dlt",
    title="DLT coefficients or easyWandData.mat",
    sniff=sniff_coefficients,
    read=read_coefficients,
    write=write_coefficients,
)
