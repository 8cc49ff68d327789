"""Read poses in NWB files (ndx-pose): a PoseEstimation per camera, a series per keypoint.

Traps: NWB has times and not frame numbers, as a rate or as timestamps that may be rounded; poses
may lie anywhere below the top, also behind links; one series for several videos says nothing of
each of them. Read with h5py alone, so that no extra is needed.
"""

from typing import Any

import h5py
import numpy as np

from mocap_calib.errors import FormatError
from mocap_calib.io.detections import blank, fill_missing_scores, make_view
from mocap_calib.io.document import Document
from mocap_calib.io.file import LARGEST_EXACT_FLOAT, Origin
from mocap_calib.io.format import Format
from mocap_calib.io.hdf5 import array, damage_refused, keys, names, text
from mocap_calib.io.read_options import ReadOptions
from mocap_calib.types import Floats, Ints, Keypoints2D

_REMEDY = "write it with ndx-pose again"
_DEPTH = 6  # how far below the top poses are looked for


def sniff(document: Document) -> bool:
    """Return whether the file is HDF5 with NWB's mark."""
    with damage_refused(document.source, "a whole HDF5 file", _REMEDY):
        if "processing" not in keys(document):
            return False
        file = document.hdf5
        return "nwb_version" in file.attrs or "session_description" in file


def read(document: Document, options: ReadOptions) -> tuple[Keypoints2D, ...]:
    """Read a camera per PoseEstimation, called by its name; by the file's where there is but one.

    Each has one individual. Raises FormatError.
    """
    source, file = document.source, document.hdf5
    with damage_refused(source, "a whole NWB file", _REMEDY):
        groups = _groups_of_type(file, "PoseEstimation")
        if not groups:
            raise FormatError(source, "a PoseEstimation of ndx-pose", "none", "give another file")
        if len(groups) == 1:
            return (_view(groups[0], document.origin),)
        return tuple(_view(group, Origin(_name(group), source)) for group in groups)


def _name(group: Any) -> str:
    return str(group.name.rpartition("/")[2])


def _groups_of_type(group: Any, kind: str, depth: int = _DEPTH) -> list[Any]:
    """Return the groups of a neurodata type up to `depth` levels below this group.

    Those directly below come first.
    """
    # links are not followed, so that nothing is found twice
    links = {name: group.get(name, getlink=True) for name in group}
    own = [group[name] for name, link in links.items() if isinstance(link, h5py.HardLink)]
    children = [child for child in own if isinstance(child, h5py.Group)]
    found = [child for child in children if _is_of_type(child, kind)]
    for child in children if depth > 1 else ():
        if not _is_of_type(child, kind):
            found += _groups_of_type(child, kind, depth - 1)
    return found


def _is_of_type(group: Any, kind: str) -> bool:
    return text(group.attrs.get("neurodata_type", "")) == kind


def _view(group: Any, origin: Origin) -> Keypoints2D:
    """Return the camera of a PoseEstimation. Raises FormatError."""
    source = f"{origin.source}: {group.name}"
    _check_one_video(group, source)
    series_of = {_name(child): child for child in _groups_of_type(group, "PoseEstimationSeries", 1)}
    values = _values(series_of, source)
    frames, rate = frame_numbers_and_rate(next(iter(series_of.values())), source)
    if len(frames) != len(values):
        raise FormatError(source, f"a time for each of {len(values)} frames", len(frames), _REMEDY)
    values, remarks = fill_missing_scores(values)
    counted = f"NWB has times, not frame numbers: a frame is the time x {rate:g} per second"
    return make_view(
        origin,
        tuple(series_of),
        frames,
        values,
        tracked=True,
        image_size=_image_size(group, source),
        remarks=(counted, *remarks),
    )


def _check_one_video(group: Any, source: str) -> None:
    """Raise FormatError where the poses are of several videos."""
    videos = names(group, "original_videos", source) if "original_videos" in group else ()
    if len(videos) > 1:
        found, remedy = f"one series for {', '.join(videos)}", "write a PoseEstimation per camera"
        raise FormatError(source, "the poses of one camera", found, remedy)


def _values(series_of: dict[str, Any], source: str) -> Floats:
    """Return `[frame, 1, keypoint, 3]` x, y, confidence of a series per keypoint.

    Raises FormatError.
    """
    positions = [array(series, "data", source).astype(np.float64) for series in series_of.values()]
    shapes = sorted({each.shape for each in positions})
    if any(len(shape) == 2 and shape[1] == 3 for shape in shapes):
        raise FormatError(source, "2D series (x, y)", "3D ones", "give the 2D poses of each camera")
    if len(shapes) != 1 or len(shapes[0]) != 2 or shapes[0][1] != 2:
        raise FormatError(source, "series of one length with x and y", shapes, _REMEDY)
    values = blank(shapes[0][0], 1, len(positions), source)
    for keypoint, series in enumerate(series_of.values()):
        values[:, 0, keypoint, :2] = positions[keypoint]
        if "confidence" in series:
            values[:, 0, keypoint, 2] = array(series, "confidence", source)
    return values


def frame_numbers_and_rate(series: Any, source: str) -> tuple[Ints, float]:
    """Return the `[frame]` numbers of a PoseEstimationSeries, and its frames per second.

    Frame 0 is at time 0 of the session, so that cameras stay aligned. The rate is the file's, else
    one frame in the median step of the timestamps; each step is a whole number of frames, so that
    rounded or jittered times do not add up. Raises FormatError.
    """
    length = len(series["data"])
    if "starting_time" in series:
        rate = float(series["starting_time"].attrs["rate"])
        start = float(series["starting_time"][()])
        steps = np.ones(max(length - 1, 0))
    else:
        times = array(series, "timestamps", source).astype(np.float64).reshape(-1)
        rate = float(series.attrs.get("fps", _median_rate(times)))
        start = float(times[0]) if len(times) else 0.0
        steps = np.rint(np.diff(times) * rate)
    first = np.rint(start * rate)
    in_range = abs(first) < LARGEST_EXACT_FLOAT and steps.sum() < LARGEST_EXACT_FLOAT
    if not (rate > 0 and in_range and (steps >= 1).all()):
        raise FormatError(source, "times that increase", "others", _REMEDY)
    counted = np.concatenate([[0], np.cumsum(steps)])[:length]
    return int(first) + counted.astype(np.int64), rate


def _median_rate(times: Floats) -> float:
    """Return one over the median step of `[frame]` times; NaN where it is not above 0."""
    if len(times) < 2:
        return 1.0
    step = np.median(np.diff(times))
    return float(np.round(1 / step, 6)) if step > 0 else np.nan


def _image_size(group: Any, source: str) -> tuple[int, int]:
    """Return the (width, height) in `dimensions`; (0, 0) where it does not say it of one camera."""
    if "dimensions" not in group:
        return (0, 0)
    size = array(group, "dimensions", source).reshape(-1)
    return (int(size[0]), int(size[1])) if size.size == 2 else (0, 0)


KEYPOINTS = Format(
    kind="keypoints",
    name="nwb",
    title="NWB ndx-pose .nwb",
    sniff=sniff,
    read=read,
)
