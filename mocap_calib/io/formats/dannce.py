"""Read Label3D's and DANNCE's .mat: the points that were clicked, all cameras in one file.

Traps: keypoints have no names; only some frames are labelled, and `data_frame` says which; points
have no score; MATLAB 7.3 files are HDF5 of another kind and are refused.
"""

from typing import Any

import numpy as np

from mocap_calib.errors import FormatError
from mocap_calib.io.document import Document
from mocap_calib.io.file import NO_SCORE, Origin, blank, make_view
from mocap_calib.io.format import Format
from mocap_calib.io.keypoints.layouts import choose_layout
from mocap_calib.io.keypoints.options import ReadOptions
from mocap_calib.io.matlab import read_mat
from mocap_calib.types import Floats, Ints, Keypoints2D

_REMEDY = "save it from Label3D again, for MATLAB 7 (not 7.3)"
_VARIABLES = ("camnames", "labelData")


def sniff(document: Document) -> bool:
    """Return whether the file has the mark of a MATLAB 5 file."""
    return document.start.startswith(b"MATLAB 5.0 MAT-file")


def read(document: Document, options: ReadOptions) -> tuple[Keypoints2D, ...]:
    """Read the labelled frames of each camera.

    Keypoints are `point_1`, ... where the user does not name them. Raises FormatError.
    """
    source = document.source
    cameras, labels = _read_variables(document)
    return tuple(
        _view(Origin(camera, source), label, options)
        for camera, label in zip(cameras, labels, strict=True)
    )


def _read_variables(document: Document) -> tuple[list[str], list[Any]]:
    """Return the names of the cameras and the labels of each. Raises FormatError."""
    source = document.source
    variables = read_mat(
        document.content,
        _VARIABLES,
        source=source,
        expected="a whole MATLAB file",
        remedy=_REMEDY,
    )
    missing = set(_VARIABLES) - variables.keys()
    if missing:
        raise FormatError(
            source,
            "the variables camnames and labelData",
            f"no {' and no '.join(sorted(missing))}",
            "give the file that Label3D saved",
        )
    cameras, labels = variables["camnames"], variables["labelData"]
    if not _are_cells_of_cameras(cameras, labels):
        raise FormatError(
            source, "cells camnames and labelData, one for each camera", "others", _REMEDY
        )
    return cameras, labels


def _are_cells_of_cameras(cameras: Any, labels: Any) -> bool:
    """Return whether these are a list of names and a list with an entry for each of them."""
    if not isinstance(cameras, list) or not isinstance(labels, list):
        return False
    named = all(isinstance(camera, str) and camera for camera in cameras)
    return named and len(cameras) == len(labels)


def _view(origin: Origin, label: Any, options: ReadOptions) -> Keypoints2D:
    """Return the labelled frames of one camera. Raises FormatError."""
    source = f"{origin.source}: {origin.camera}"
    frames, positions = _frames_and_positions(label, source)
    count = positions.shape[1]
    numbered = tuple(f"point_{k + 1}" for k in range(count))
    names = choose_layout(count, given=options.layout or numbered, source=source)
    values = blank(len(frames), 1, count, source)
    values[:, 0, :, :2] = positions
    values[..., 2] = 1.0
    return make_view(origin, names, frames, values, tracked=True, remarks=(NO_SCORE,))


def _frames_and_positions(label: Any, source: str) -> tuple[Ints, Floats]:
    """Return `[frame]` numbers and `[frame, keypoint, 2]` positions. Raises FormatError."""
    try:
        points = np.asarray(label[0]["data_2d"], dtype=np.float64)
        with np.errstate(invalid="ignore"):  # what is no number becomes a negative one
            frames = np.asarray(label[0]["data_frame"]).reshape(-1).astype(np.int64)
        positions = points.reshape(len(frames), -1, 2)
    except (ValueError, IndexError, TypeError, OverflowError, KeyError) as error:
        raise FormatError(
            source, "data_2d [frame, 2 x keypoint] and data_frame", f"an error ({error})", _REMEDY
        ) from None
    if not len(frames) or not positions.shape[1] or frames.min() < 0:
        raise FormatError(source, "labelled frames", "none", "label some first")
    return frames, positions


KEYPOINTS = Format(
    kind="keypoints",
    name="label3d",
    title="Label3D .mat",
    sniff=sniff,
    read=read,
)
