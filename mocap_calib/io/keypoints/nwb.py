"""Poses in NWB files (ndx-pose): a PoseEstimation per camera, a series per keypoint. Read with h5py alone: no extra is needed."""

from typing import Any

import h5py
import numpy as np

from mocap_calib.io.file import Origin, blank, fill_missing_scores, make_view, malformed
from mocap_calib.io.hdf5 import array, damage_refused, keys, names, text
from mocap_calib.io.keypoints.document import Document, Item, ReadOptions
from mocap_calib.types import Ints, Keypoints2D

_REMEDY = "write it with ndx-pose again"
_DEPTH = 6  # how far below the top poses are looked for


def sniff(document: Document) -> bool:
    """HDF5 with NWB's mark."""
    with damage_refused(document.source, "a whole HDF5 file", _REMEDY):
        return {"processing"} <= keys(document) and (
            "nwb_version" in document.hdf5.attrs or "session_description" in document.hdf5
        )


def read(item: Item, options: ReadOptions) -> tuple[Keypoints2D, ...]:  # noqa: ARG001 - a reader's signature
    """A camera per PoseEstimation, called by its name; by the file's where there is but one. One individual each. Raises FormatError."""
    source, file = item.origin.source, item.document.hdf5
    with damage_refused(source, "a whole NWB file", _REMEDY):
        found = _of_type(file, "PoseEstimation")
        if not found:
            raise malformed(source, "a PoseEstimation of ndx-pose", "none", "give another file")
        if len(found) == 1:
            return (_view(found[0], item.origin),)
        return tuple(_view(group, Origin(group.name.rpartition("/")[2], source)) for group in found)


def _of_type(group: Any, kind: str, depth: int = _DEPTH) -> list[Any]:
    """The groups of a neurodata type below this one; links are not followed, so that nothing is found twice."""
    children = (
        [group[name] for name in group if isinstance(group.get(name, getlink=True), h5py.HardLink)]
        if depth
        else []
    )
    groups = [child for child in children if isinstance(child, h5py.Group)]
    own = [child for child in groups if text(child.attrs.get("neurodata_type", "")) == kind]
    return own + [
        found for child in groups if child not in own for found in _of_type(child, kind, depth - 1)
    ]


def _view(group: Any, origin: Origin) -> Keypoints2D:
    source = f"{origin.source}: {group.name}"
    videos = names(group, "original_videos", source) if "original_videos" in group else ()
    if len(videos) > 1:
        raise malformed(
            source,
            "the poses of one camera",
            f"one series for {', '.join(videos)}",
            "write a PoseEstimation per camera",
        )
    series = {
        child.name.rpartition("/")[2]: child for child in _of_type(group, "PoseEstimationSeries", 1)
    }
    nodes = tuple(series)
    data = {name: array(each, "data", source).astype(np.float64) for name, each in series.items()}
    shapes = sorted({found.shape for found in data.values()})
    if any(len(shape) == 2 and shape[1] == 3 for shape in shapes):
        raise malformed(source, "2D series (x, y)", "3D ones", "give the 2D poses of each camera")
    if len(shapes) != 1 or len(shapes[0]) != 2 or shapes[0][1] != 2:
        raise malformed(source, "series of one length with x and y", shapes, _REMEDY)
    values = blank(shapes[0][0], 1, len(nodes), source)
    for k, name in enumerate(nodes):
        values[:, 0, k, :2] = data[name]
        if "confidence" in series[name]:
            values[:, 0, k, 2] = array(series[name], "confidence", source)
    frames, rate = frames_of(next(iter(series.values())), source)
    if len(frames) != len(values):
        raise malformed(source, f"a time for each of {len(values)} frames", len(frames), _REMEDY)
    values, remarks = fill_missing_scores(values)
    counted = f"NWB has times, not frame numbers: a frame is the time x {rate:g} per second"
    return make_view(
        origin,
        nodes,
        frames,
        values,
        tracked=True,
        image_size=_size(group, source),
        remarks=(counted, *remarks),
    )


def frames_of(series: Any, source: str) -> tuple[Ints, float]:
    """`[frame]` numbers and the rate (1/s) of a PoseEstimationSeries: 0 is at time 0 of the session, so that cameras stay aligned.

    The rate is the file's, else one frame in the median step of the timestamps; each step is a whole number of frames, so that
    rounded or jittered times do not add up. Raises FormatError.
    """
    if "starting_time" in series:
        rate = float(series["starting_time"].attrs["rate"])
        first, steps = float(series["starting_time"][()]), np.ones(max(len(series["data"]) - 1, 0))
    else:
        times = array(series, "timestamps", source).astype(np.float64).reshape(-1)
        first, step = (
            times[0] if len(times) else 0.0,
            np.median(np.diff(times)) if len(times) > 1 else np.nan,
        )
        rate = float(
            series.attrs.get(
                "fps", np.round(1 / step, 6) if step > 0 else np.nan if len(times) > 1 else 1.0
            )
        )
        steps = np.rint(np.diff(times) * rate)
    start = np.rint(first * rate)
    if not (rate > 0 and abs(start) < 2**53 and (steps >= 1).all() and steps.sum() < 2**53):
        raise malformed(source, "times that increase", "others", _REMEDY)
    return int(start) + np.concatenate([[0], np.cumsum(steps)])[: len(series["data"])].astype(
        np.int64
    ), rate


def _size(group: Any, source: str) -> tuple[int, int]:
    """(width, height) as `dimensions` has them, of one camera."""
    size = array(group, "dimensions", source).reshape(-1) if "dimensions" in group else np.zeros(0)
    return (int(size[0]), int(size[1])) if size.size == 2 else (0, 0)
