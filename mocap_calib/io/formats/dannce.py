"""Label3D's and DANNCE's .mat: the points that were clicked, and the cameras.

* Points: keypoints have no names; only some frames are labelled, and `data_frame` says which;
  points have no score.
* One file has cells `params`, a struct a camera, and `camnames`; the fields of a file for one
  camera stand at its top, and its name names the camera (hires_cam1_params.mat).
* K and r are those of row vectors, as MATLAB has them: the transpose of ours.
* RDistort has k1 k2 (k3), TDistort has p1 p2. MATLAB estimates a skew, which is noise.
* Lengths are millimetres; there are no image sizes.
* Files of version 7.3 are HDF5 of another kind and are refused.
"""

import io
import re
from collections.abc import Mapping
from typing import Any, cast

import numpy as np

from mocap_calib.errors import FormatError, one_line
from mocap_calib.io.cameras import (
    CameraFile,
    RawCamera,
    check_rig,
    collect_cameras,
    lens_terms,
    numbers,
    skew_in_pixels,
)
from mocap_calib.io.crash_guard import guard
from mocap_calib.io.detections import blank, make_view
from mocap_calib.io.document import Document, need
from mocap_calib.io.file import Origin
from mocap_calib.io.format import Format, Written
from mocap_calib.io.read_options import ReadOptions, choose_layout
from mocap_calib.types import CameraRig, Floats, Ints, Keypoints2D

_REMEDY = "save it again, for MATLAB 7 (save -v7)"
_VARIABLES = ("camnames", "labelData")
_NUMERIC = (
    "double",
    "single",
    "logical",
    *(f"{u}int{b}" for u in ("", "u") for b in (8, 16, 32, 64)),
)
_FIELDS = ("K", "RDistort", "TDistort", "r", "t")
_MOST_SKEW = 1e-2  # of the focal length: what MATLAB estimates where there is only noise
_ONE_CAMERA_STEM = r"(?:hires_)?(?P<camera>.+?)(?:_params)?"
_HEADER = rb"\AMATLAB 5.0 MAT-file.{96}"  # text of 116 bytes, with the time


# --- keypoints


def sniff(document: Document) -> bool:
    """Return whether MATLAB wrote the file."""
    return not document.is_folder and document.start.startswith(b"MATLAB")


def read(document: Document, options: ReadOptions) -> tuple[Keypoints2D, ...]:
    """Read the labelled frames of each camera.

    Keypoints are `point_1`, ... where the user does not name them. Raises FormatError.
    """
    found = read_mat(document, _VARIABLES)
    missing = sorted(set(_VARIABLES) - found.keys())
    if missing:
        absent, remedy = f"no {' and no '.join(missing)}", "give the file that Label3D saved"
        raise document.refuse("the variables camnames and labelData", absent, remedy)
    cameras, labels = found["camnames"], found["labelData"]
    are_cells = isinstance(cameras, list) and isinstance(labels, list)
    if not are_cells or len(cameras) != len(labels) or not all(map(_is_name, cameras)):
        expected = "cells camnames and labelData, one for each camera"
        raise document.refuse(expected, "others", _REMEDY)
    return tuple(
        _view(Origin(camera, document.source), label, options)
        for camera, label in zip(cameras, labels, strict=True)
    )


def _is_name(value: Any) -> bool:
    return isinstance(value, str) and bool(value)


def _view(origin: Origin, label: Any, options: ReadOptions) -> Keypoints2D:
    """Return the labelled frames of one camera. Raises FormatError."""
    source = f"{origin.source}: {origin.camera}"
    frames, positions = _frames_and_positions(label, source)
    count = positions.shape[1]
    numbered = tuple(f"point_{k + 1}" for k in range(count))
    names = choose_layout(count, options.layout or numbered, source)
    values = blank(len(frames), 1, count, source)
    values[:, 0, :, :2] = positions
    return make_view(origin, names, frames, values, tracked=True)


def _frames_and_positions(label: Any, source: str) -> tuple[Ints, Floats]:
    """Return `[frame]` numbers and `[frame, keypoint, 2]` positions. Raises FormatError."""
    try:
        points = np.asarray(label[0]["data_2d"], dtype=np.float64)
        with np.errstate(invalid="ignore"):  # what is no number becomes a negative one
            frames = np.asarray(label[0]["data_frame"]).reshape(-1).astype(np.int64)
        positions = points.reshape(len(frames), -1, 2)
    except (ValueError, IndexError, TypeError, OverflowError, KeyError) as error:
        expected = "data_2d [frame, 2 x keypoint] and data_frame"
        raise FormatError(source, expected, f"an error ({error})", _REMEDY) from None
    if not len(frames) or not positions.shape[1] or frames.min() < 0:
        raise FormatError(source, "labelled frames", "none", "label some first")
    return frames, positions


# --- cameras


def read_cameras(document: Document) -> CameraFile:
    """Read all cameras of a file, or its one camera. Raises FormatError."""
    raws: list[RawCamera] = []
    notes: list[str] = []
    for name, fields in _load(document):
        where = f"{document.source}: camera {name}"
        need(fields, _FIELDS, where)
        matrix = numbers(fields["K"], "a 3 x 3 matrix K", where, 9).reshape(3, 3).copy()
        if 0 < abs(matrix[1, 0]) < _MOST_SKEW * abs(matrix[0, 0]):
            moved = f"{skew_in_pixels(matrix.T):.1f} pixels at the edge of the image"
            notes.append(
                f"camera {name}: the skew {matrix[1, 0]:.2f} is left out, which is up to {moved}"
            )
            matrix[1, 0] = 0.0
        radial = numbers(fields["RDistort"], "2 or 3 numbers RDistort", where, 2, 3).ravel()
        tangential = numbers(fields["TDistort"], "2 numbers TDistort", where, 2).ravel()
        raws.append(
            RawCamera(
                name=name,
                matrix=matrix,
                distortion=[*radial[:2], *tangential, *radial[2:]],
                rotation=fields["r"],
                translation=fields["t"],
                by_columns=True,
            )
        )
    return collect_cameras(raws, document.source, notes=notes)


def _load(document: Document) -> list[tuple[str, dict[str, Any]]]:
    """Return the name and the fields of every camera; names may be missing in the file.

    Raises FormatError.
    """
    found = read_mat(document, ("params", "camnames", *_FIELDS))
    if "params" not in found and found.keys() >= set(_FIELDS):
        name = re.fullmatch(_ONE_CAMERA_STEM, document.stem)
        return [(name["camera"] if name else document.stem, found)]
    cells, camnames = found.get("params"), found.get("camnames")
    cells = cells if isinstance(cells, list) else []
    # a cell is an array of one struct
    structs = [
        each[0] if isinstance(each, list) and len(each) == 1 else each for each in cells or ()
    ]
    names = [str(name).strip() for name in camnames] if isinstance(camnames, list) else []
    are_structs = structs and all(isinstance(fields, dict) for fields in structs)
    if not are_structs or len(names) not in (0, len(structs)):
        fields = ", ".join(_FIELDS)
        raise document.refuse(
            f"cells params, a camera each, and as many camnames; or {fields} of one camera",
            f"{len(structs)} and {len(names)}",
            "give the file that has the cameras",
        )
    return list(zip(names or [f"Camera{k + 1}" for k in range(len(structs))], structs, strict=True))


def write_cameras(rig: CameraRig, provenance: Mapping[str, Any]) -> Written:
    """Write one file of all cameras. Raises MismatchError."""
    from scipy.io import savemat  # noqa: PLC0415 - half of the time that all formats take to import

    lost = check_rig(rig, provenance, "dannce", terms=5, sizes="lost", verdict=False)
    params = np.empty((len(rig.cameras), 1), dtype=object)
    names = np.empty((1, len(rig.cameras)), dtype=object)
    for view, camera in enumerate(rig):
        terms = lens_terms(camera, 5)[None]
        params[view, 0] = {  # for row vectors
            "K": camera.matrix.T,
            "RDistort": terms[:, [0, 1, 4]],
            "TDistort": terms[:, 2:4],
            "r": camera.rotation.T,
            "t": camera.translation[None],
        }
        names[0, view] = camera.name
    file = io.BytesIO()
    savemat(cast(Any, file), {"params": params, "camnames": names})
    header = b"MATLAB 5.0 MAT-file".ljust(115)
    content = re.sub(_HEADER, header, file.getvalue(), flags=re.S)  # the same rig, the same bytes
    return Written({"label3d_dannce.mat": content}, lost)


# --- variables of MATLAB files (up to version 7), read by scipy behind the crash guard


def read_mat(document: Document, wanted: tuple[str, ...]) -> dict[str, Any]:
    """Return the variables of these names, and 0 for other numbers.

    They are arrays, text, lists for cells, and lists of dictionaries for structs (both in MATLAB's
    order); None for functions and objects.

    Raises FormatError.
    """
    if document.content.startswith(b"MATLAB 7.3"):
        raise document.refuse("a .mat file of version 7 or below", "version 7.3", _REMEDY)
    found = guard(
        _load_mat,
        document.content,
        wanted,
        document.source,
        what="MATLAB file",
        library="scipy",
        source=document.source,
        size=len(document.content),
        packed=False,
    )
    return cast(dict[str, Any], document.account.add(found))


def _load_mat(content: bytes, wanted: tuple[str, ...], source: str) -> dict[str, Any]:
    """Read the variables in the process that is for it."""
    from scipy.io import loadmat, whosmat  # noqa: PLC0415 - takes 0.2 s

    try:
        listed = whosmat(cast(Any, io.BytesIO(content)))
        others = {name: 0 for name, _, kind in listed if kind in _NUMERIC and name not in wanted}
        found = loadmat(cast(Any, io.BytesIO(content)), variable_names=wanted)
        return others | {name: _simplify(found[name]) for name in wanted if name in found}
    except MemoryError:
        raise
    except Exception as error:  # scipy raises whatever damage leads to
        reason = f"an error ({one_line(error) or type(error).__name__})"
        raise FormatError(source, "a whole MATLAB file", reason, _REMEDY) from None


def _simplify(value: Any) -> Any:
    """Return lists, dictionaries and text for what scipy makes arrays of objects of."""
    if not isinstance(value, np.ndarray):
        return None
    if value.dtype.names:
        structs = value.ravel(order="F")
        return [{name: _simplify(each[name]) for name in value.dtype.names} for each in structs]
    if value.dtype.kind == "O":
        return [_simplify(each) for each in value.ravel(order="F")]
    return "".join(value.ravel().tolist()) if value.dtype.kind == "U" else value


KEYPOINTS = Format(
    name="label3d",
    title="Label3D .mat",
    sniff=sniff,
    read=read,
)
CAMERAS = Format(
    name="dannce",
    title="Label3D or DANNCE .mat",
    sniff=sniff,
    read=read_cameras,
    write=write_cameras,
    unit="mm",
    endings=(".mat",),
)
