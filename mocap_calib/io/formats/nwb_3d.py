"""NWB with ndx-pose: a PoseEstimation for each individual, a series for each keypoint.

* A PoseEstimationSeries has times and no frame numbers: frames are counted from the times.
* Series of two dimensions are keypoints, which `io.formats.nwb` reads.
* Values are multiplied by the attribute `conversion`.
* Written through pynwb and ndx-pose (`pip install mocap-calib[nwb]`); read with h5py alone.
"""

import tempfile
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from mocap_calib.io.document import Document
from mocap_calib.io.format import Format, Loss
from mocap_calib.io.formats.nwb import frame_numbers_and_rate
from mocap_calib.io.hdf5 import array
from mocap_calib.io.poses import (
    COVARIANCES,
    ERRORS,
    VIEWS,
    PoseFile,
    attribute,
    bare_poses,
    is_hdf5_that,
    mark_missing,
    need_keypoints,
    need_rate,
    opened_hdf5,
)
from mocap_calib.io.units import known_unit
from mocap_calib.results import Poses3D

_SERIES = "PoseEstimationSeries"
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_NAMES = r"[^/:\x00-\x1f\ud800-\udfff]*[^/:\s\x00-\x1f\ud800-\udfff]"
SESSION = Loss("when the session was: 1970-01-01 is written", bool)


def sniff(document: Document) -> bool:
    """Return whether there is an estimated pose in three dimensions."""
    return is_hdf5_that(document, _has_series)


def _has_series(file: h5py.File) -> bool:
    return bool(_find_series(file))


# --- reading


def _find_series(file: h5py.File) -> dict[tuple[str, str], Any]:
    """Return the series in three dimensions: (path of the individual, keypoint) -> series."""
    found: dict[tuple[str, str], Any] = {}

    def visit(path: str, item: Any) -> None:
        if isinstance(item, h5py.Group) and attribute(item.attrs, "neurodata_type") == _SERIES:
            shape = item["data"].shape
            if len(shape) == 2 and shape[1] == 3:
                individual, _, keypoint = path.rpartition("/")
                found[individual, keypoint] = item

    file.visititems(visit)
    return found


def read(document: Document) -> PoseFile:
    """Read the poses. Raises FormatError."""
    expected = "3D poses of ndx-pose in NWB"
    with opened_hdf5(document, expected) as file:
        return _parse(file, document.source)


def _parse(file: h5py.File, source: str) -> PoseFile:
    """Read the poses. Raises FormatError, and ValueError and more where the file is damaged."""
    found = _find_series(file)
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
        column = (slice(None), paths.index(path), keypoints.index(keypoint))
        factor = float(series["data"].attrs.get("conversion", 1.0))
        values = array(series, "data", source).astype(np.float64) * factor
        positions[column] = mark_missing(values)
        if "confidence" in series:
            confidence[column] = array(series, "confidence", source)
    unit = known_unit(attribute(first["data"].attrs, "unit"), source)
    poses = bare_poses(keypoints, frames, positions, unit=unit, confidence=confidence)
    return PoseFile(poses, rate, tuple(path.rsplit("/", 1)[-1] for path in paths))


# --- writing


def write(file: PoseFile, title: str) -> bytes:
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


POSES = Format(
    kind="poses",
    name="nwb-3d",
    title="NWB with ndx-pose",
    sniff=sniff,
    read=read,
    write=write,
    endings=(".nwb",),
    timed=True,
    packages=("pynwb", "ndx_pose"),
    extra="nwb",
    loses=(ERRORS, VIEWS, SESSION, COVARIANCES),
)
