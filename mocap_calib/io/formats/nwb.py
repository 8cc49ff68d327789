"""Poses in NWB files (ndx-pose): a PoseEstimation per camera or individual, a series per keypoint.

Series of two dimensions are the keypoints of a camera, of three the 3D poses of an individual.

Traps: NWB has times and not frame numbers, as a rate or as timestamps that may be rounded; poses
may lie anywhere below the top, also behind links; one series for several videos says nothing of
each of them; 3D values are multiplied by the attribute `conversion`. Read with h5py alone; 3D poses
are written through pynwb and ndx-pose (`pip install mocap-calib[nwb]`).
"""

import tempfile
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from mocap_calib.errors import FormatError
from mocap_calib.io.detections import blank, make_view
from mocap_calib.io.document import Document
from mocap_calib.io.file import LARGEST_EXACT_FLOAT, Origin
from mocap_calib.io.format import Format, Loss
from mocap_calib.io.hdf5 import array, damage_refused, holds_numbers, keys, names, opened_hdf5, text
from mocap_calib.io.poses import (
    COVARIANCES,
    ERRORS,
    VIEWS,
    PoseFile,
    bare_poses,
    is_hdf5_that,
    mark_missing,
    need_keypoints,
    need_rate,
)
from mocap_calib.io.read_options import ReadOptions
from mocap_calib.io.units import known_unit
from mocap_calib.results import Poses3D
from mocap_calib.types import Floats, Ints, Keypoints2D

_REMEDY = "write it with ndx-pose again"
_DEPTH = 6  # how far below the top poses are looked for
# data sets of a PoseEstimation and of its series
_KNOWN = ("dimensions", "edges", "data", "confidence", "timestamps", "starting_time")
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_NAMES = r"[^/:\x00-\x1f\ud800-\udfff]*[^/:\s\x00-\x1f\ud800-\udfff]"
_SESSION = Loss("when the session was: 1970-01-01 is written", bool)


def sniff(document: Document) -> bool:
    """Return whether the file is HDF5 with NWB's mark."""
    with damage_refused(document.source, "a whole HDF5 file", _REMEDY):
        if "processing" not in keys(document):
            return False
        file = document.hdf5
        return "nwb_version" in file.attrs or "session_description" in file


def sniff_poses(document: Document) -> bool:
    """Return whether there is an estimated pose in three dimensions."""
    return is_hdf5_that(document, lambda file: bool(_find_spatial_series(file)))


# --- keypoints


def read(document: Document, options: ReadOptions) -> tuple[Keypoints2D, ...]:
    """Read a camera per PoseEstimation, called by its name; by the file's where there is but one.

    Each has one individual. Raises FormatError.
    """
    source, file = document.source, document.hdf5
    with damage_refused(source, "a whole NWB file", _REMEDY):
        groups = _groups_of_type(file, "PoseEstimation")
        if not groups:
            raise FormatError(source, "a PoseEstimation of ndx-pose", "none", "give another file")
        for group in (*groups, *(series for each in groups for series in _series(each).values())):
            items = {str(name): group[name] for name in group if str(name) not in _KNOWN}
            document.account.add_names(name for name in items if holds_numbers(items[name]))
        if len(groups) == 1:
            return (_view(groups[0], document.origin),)
        return tuple(_view(group, Origin(_name(group), source)) for group in groups)


def _view(group: Any, origin: Origin) -> Keypoints2D:
    """Return the camera of a PoseEstimation. Raises FormatError."""
    source = f"{origin.source}: {group.name}"
    _check_one_video(group, source)
    series_of = _series(group)
    values = _values(series_of, source)
    frames, rate = frame_numbers_and_rate(next(iter(series_of.values())), source)
    if len(frames) != len(values):
        raise FormatError(source, f"a time for each of {len(values)} frames", len(frames), _REMEDY)
    counted = f"NWB has times, not frame numbers: a frame is the time x {rate:g} per second"
    return make_view(
        origin,
        tuple(series_of),
        frames,
        values,
        tracked=True,
        image_size=_image_size(group, source),
        remarks=(counted,),
    )


def _series(group: Any) -> dict[str, Any]:
    """Return the series of a PoseEstimation: name of the keypoint -> series."""
    return {_name(child): child for child in _groups_of_type(group, "PoseEstimationSeries", 1)}


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


def _image_size(group: Any, source: str) -> tuple[int, int]:
    """Return the (width, height) in `dimensions`; (0, 0) where it does not say it of one camera."""
    if "dimensions" not in group:
        return (0, 0)
    size = array(group, "dimensions", source).reshape(-1)
    return (int(size[0]), int(size[1])) if size.size == 2 else (0, 0)


# --- 3D poses


def read_poses(document: Document) -> PoseFile:
    """Read 3D poses. Raises FormatError."""
    source = document.source
    with opened_hdf5(document, "3D poses of ndx-pose in NWB", _REMEDY) as file:
        found = _find_spatial_series(file)
        if not found:
            raise ValueError("no series of three dimensions")
        paths = list(dict.fromkeys(path for path, _ in found))
        keypoints = list(dict.fromkeys(keypoint for _, keypoint in found))
        first = next(iter(found.values()))
        frames, rate = frame_numbers_and_rate(first, source)
        positions = np.full((len(frames), len(paths), len(keypoints), 3), np.nan)
        confidence = np.full(positions.shape[:3], np.nan)
        for (path, keypoint), series in found.items():
            if not np.array_equal(frame_numbers_and_rate(series, source)[0], frames):
                raise ValueError("series of different times")
            own = (slice(None), paths.index(path), keypoints.index(keypoint))
            factor = float(series["data"].attrs.get("conversion", 1.0))
            positions[own] = factor * array(series, "data", source).astype(np.float64)
            if "confidence" in series:
                confidence[own] = array(series, "confidence", source)
        unit = known_unit(text(first["data"].attrs.get("unit", "")), source)
        positions = mark_missing(positions)
        poses = bare_poses(keypoints, frames, positions, unit=unit, confidence=confidence)
        return PoseFile(poses, rate, tuple(path.rpartition("/")[2] for path in paths))


def _find_spatial_series(file: Any) -> dict[tuple[str, str], Any]:
    """Return the series in three dimensions: (path of the individual, keypoint) -> series."""
    found = {}
    for series in _groups_of_type(file, "PoseEstimationSeries"):
        path, _, keypoint = series.name.rpartition("/")
        if series["data"].shape[1:] == (3,):
            found[path, keypoint] = series
    return found


# --- writing


def write_poses(file: PoseFile, title: str) -> bytes:
    """Write the poses through pynwb. Raises MismatchError."""
    import ndx_pose  # noqa: PLC0415 - an extra
    import pynwb  # noqa: PLC0415

    rate = need_rate(file, "nwb-3d")
    need_keypoints(file, _NAMES, "text without / and :", "nwb-3d")
    nwb = pynwb.NWBFile(
        session_description=title or "3D poses",
        identifier="mocap-calib",
        session_start_time=_EPOCH,
    )
    behavior = nwb.create_processing_module("behavior", "3D poses of mocap-calib")
    skeletons = []
    for individual, name in enumerate(file.individuals):
        skeleton = ndx_pose.Skeleton(
            name=f"{name}_skeleton",
            nodes=list(file.poses.keypoints),
            edges=np.array(file.edges, dtype=np.uint8).reshape(-1, 2),
        )
        skeletons.append(skeleton)
        estimation = ndx_pose.PoseEstimation(
            name=name,
            pose_estimation_series=_make_series(ndx_pose, file.poses, individual, rate),
            skeleton=skeleton,
            source_software="mocap-calib",
        )
        behavior.add(estimation)
    behavior.add(ndx_pose.Skeletons(skeletons=skeletons))
    return _format_file(pynwb, nwb)


def _make_series(ndx_pose: Any, poses: Poses3D, individual: int, rate: float) -> list[Any]:
    """Return a PoseEstimationSeries for each keypoint of an individual (an index)."""
    return [
        ndx_pose.PoseEstimationSeries(
            name=name,
            description=name,
            data=poses.positions[:, individual, keypoint],
            unit=poses.unit,
            reference_frame="the cameras' world; see the camera file",
            timestamps=poses.frames / rate,
            confidence=poses.confidence[:, individual, keypoint],
            confidence_definition="mean confidence of the detections used",
        )
        for keypoint, name in enumerate(poses.keypoints)
    ]


def _format_file(pynwb: Any, nwb: Any) -> bytes:
    """Return the content of a file, which pynwb writes to disks alone."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "poses.nwb"
        with pynwb.NWBHDF5IO(str(path), "w") as out:
            out.write(nwb)
        return path.read_bytes()


# --- groups and times


def _name(group: Any) -> str:
    return str(group.name.rpartition("/")[2])


def _groups_of_type(group: Any, kind: str, depth: int = _DEPTH) -> list[Any]:
    """Return the groups of a neurodata type up to `depth` levels below this group.

    Those directly below come first.
    """
    import h5py  # noqa: PLC0415 - as in document.py

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


KEYPOINTS = Format(
    name="nwb",
    title="NWB ndx-pose .nwb",
    sniff=sniff,
    read=read,
)
POSES = Format(
    name="nwb-3d",
    title="NWB with ndx-pose",
    sniff=sniff_poses,
    read=read_poses,
    write=write_poses,
    endings=(".nwb",),
    timed=True,
    packages=("pynwb", "ndx_pose"),
    extra="nwb",
    loses=(ERRORS, VIEWS, _SESSION, COVARIANCES),
)
