"""Label3D's and DANNCE's .mat: the points that were clicked in each camera, all cameras in one file."""

from typing import Any

import numpy as np

from mocap_calib.io.file import NO_SCORE, Origin, blank, make_view, malformed
from mocap_calib.io.keypoints.document import Document, Item, ReadOptions
from mocap_calib.io.keypoints.layouts import layout_for
from mocap_calib.io.mat5 import DAMAGE, read_mat
from mocap_calib.types import Keypoints2D

_REMEDY = "save it from Label3D again, for MATLAB 7 (not 7.3)"


def sniff(document: Document) -> bool:
    """The mark of a MATLAB 5 file."""
    return document.content.startswith(b"MATLAB 5.0 MAT-file")


def read(item: Item, options: ReadOptions) -> tuple[Keypoints2D, ...]:
    """The labelled frames of each camera; keypoints are `point_1`, ... where the user does not name them. Raises FormatError."""
    source = item.origin.source
    try:
        found = read_mat(item.document.content, ("camnames", "labelData"))
    except DAMAGE as error:
        raise malformed(
            source, "a whole MATLAB file", f"an error ({error or type(error).__name__})", _REMEDY
        ) from None
    missing = {"camnames", "labelData"} - found.keys()
    if missing:
        raise malformed(
            source,
            "the variables camnames and labelData",
            f"no {' and no '.join(sorted(missing))}",
            "give the file that Label3D saved",
        )
    cameras, labels = found["camnames"], found["labelData"]
    if (
        not isinstance(cameras, list)
        or not isinstance(labels, list)
        or len(cameras) != len(labels)
        or not all(isinstance(c, str) and c for c in cameras)
    ):
        raise malformed(
            source, "cells camnames and labelData, one for each camera", "others", _REMEDY
        )
    return tuple(
        _view(Origin(camera, source), label, options)
        for camera, label in zip(cameras, labels, strict=True)
    )


def _view(origin: Origin, label: Any, options: ReadOptions) -> Keypoints2D:
    source = f"{origin.source}: {origin.camera}"
    try:
        points = np.asarray(label[0]["data_2d"], dtype=np.float64)
        frames = np.asarray(label[0]["data_frame"]).reshape(-1).astype(np.int64)
        positions = points.reshape(len(frames), -1, 2)
    except (ValueError, IndexError, TypeError, OverflowError, KeyError) as error:
        raise malformed(
            source, "data_2d [frame, 2 x keypoint] and data_frame", f"an error ({error})", _REMEDY
        ) from None
    if not len(frames) or not positions.shape[1] or frames.min() < 0:
        raise malformed(source, "labelled frames", "none", "label some first")
    count = positions.shape[1]
    names = layout_for(
        count, options.layout or tuple(f"point_{k + 1}" for k in range(count)), source
    )
    values = blank(len(frames), 1, count, source)
    values[:, 0, :, :2], values[..., 2] = positions, 1.0
    return make_view(origin, names, frames, values, tracked=True, remarks=(NO_SCORE,))
