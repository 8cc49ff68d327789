"""NWB with ndx-pose: a PoseEstimation an individual, a PoseEstimationSeries a keypoint.

Written through pynwb and ndx-pose (`pip install mocap-calib[nwb]`); read with h5py alone.
"""

import io
import tempfile
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from mocap_calib.errors import MismatchError
from mocap_calib.io.file import malformed, one_line
from mocap_calib.io.hdf5 import array
from mocap_calib.io.keypoints.nwb import frame_numbers_and_rate
from mocap_calib.io.poses.arrays import looks
from mocap_calib.io.poses.common import (
    DAMAGE,
    PoseFile,
    WrittenPoses,
    attribute,
    bare_poses,
    need_keypoints,
    need_rate,
)
from mocap_calib.io.units import known_unit

_SERIES = "PoseEstimationSeries"
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


def sniff(content: bytes) -> bool:
    """Any estimated pose in three dimensions."""
    return looks(
        content,
        lambda file: any(
            series["data"].ndim == 2 and series["data"].shape[1] == 3
            for _, _, series in _series(file)
        ),
    )


def _series(file: h5py.File) -> list[tuple[str, str, Any]]:
    """(group, name, series) of all keypoints."""
    found: list[tuple[str, str, Any]] = []

    def visit(path: str, item: Any) -> None:
        if isinstance(item, h5py.Group) and attribute(item.attrs, "neurodata_type") == _SERIES:
            group, _, name = path.rpartition("/")
            found.append((group, name, item))

    file.visititems(visit)
    return found


def parse(content: bytes, source: str) -> PoseFile:
    """Every PoseEstimation is an individual; frames are counted from the times. Raises FormatError."""
    try:
        with h5py.File(io.BytesIO(content), "r") as file:
            return _parse(file, source)
    except DAMAGE as error:
        raise malformed(
            source,
            "3D poses of ndx-pose in NWB",
            f"an error ({one_line(error)})",
            "write the file again",
        ) from None


def _parse(file: h5py.File, source: str) -> PoseFile:
    series = [
        (group, name, item)
        for group, name, item in _series(file)
        if item["data"].ndim == 2 and item["data"].shape[1] == 3
    ]
    groups = list(dict.fromkeys(group for group, _, _ in series))
    keypoints = list(dict.fromkeys(name for _, name, _ in series))
    by_name = {(group, name): item for group, name, item in series}
    frames, rate = frame_numbers_and_rate(series[0][2], source)
    positions = np.full((len(frames), len(groups), len(keypoints), 3), np.nan)
    confidence = np.full(positions.shape[:3], np.nan)
    for (group, name), item in by_name.items():
        place = (slice(None), groups.index(group), keypoints.index(name))
        if not np.array_equal(frame_numbers_and_rate(item, source)[0], frames):
            raise ValueError("series of different times")
        factor = float(item["data"].attrs.get("conversion", 1.0))
        values = array(item, "data", source).astype(np.float64) * factor
        positions[place] = np.where(np.isfinite(values).all(-1, keepdims=True), values, np.nan)
        if "confidence" in item:
            confidence[place] = array(item, "confidence", source)
    unit = known_unit(attribute(series[0][2]["data"].attrs, "unit"), source)
    names = tuple(group.rsplit("/", 1)[-1] for group in groups)
    return PoseFile(bare_poses(keypoints, frames, positions, unit, confidence), rate, names)


def write(file: PoseFile, title: str) -> WrittenPoses:
    """Through pynwb, which writes files alone. Raises MismatchError, also where it is not installed."""
    rate = need_rate(file, "nwb-3d")
    need_keypoints(
        file,
        r"[^/:\x00-\x1f\ud800-\udfff]*[^/:\s\x00-\x1f\ud800-\udfff]",
        "text without / and :",
        "nwb-3d",
    )
    try:
        import ndx_pose  # noqa: PLC0415 - an extra
        import pynwb  # noqa: PLC0415
    except ImportError:
        raise MismatchError(
            "nwb-3d: expected pynwb and ndx-pose, found none; install them with `pip install mocap-calib[nwb]`"
        ) from None
    nwb = pynwb.NWBFile(
        session_description=title or "3D poses", identifier="mocap-calib", session_start_time=_EPOCH
    )
    behavior = nwb.create_processing_module("behavior", "3D poses of mocap-calib")
    poses = file.poses
    skeletons = []
    for k, name in enumerate(file.individuals):
        skeletons.append(
            ndx_pose.Skeleton(
                name=f"{name}_skeleton",
                nodes=list(poses.keypoints),
                edges=np.zeros((0, 2), dtype=np.uint8),
            )
        )
        series = [
            ndx_pose.PoseEstimationSeries(
                name=keypoint,
                description=keypoint,
                data=poses.positions[:, k, j],
                unit=poses.unit,
                reference_frame="the cameras' world; see the camera file",
                timestamps=poses.frames / rate,
                confidence=poses.confidence[:, k, j],
                confidence_definition="mean confidence of the detections used",
            )
            for j, keypoint in enumerate(poses.keypoints)
        ]
        behavior.add(
            ndx_pose.PoseEstimation(
                name=name,
                pose_estimation_series=series,
                skeleton=skeletons[-1],
                source_software="mocap-calib",
            )
        )
    behavior.add(ndx_pose.Skeletons(skeletons=skeletons))
    with tempfile.TemporaryDirectory() as work:
        path = Path(work) / "poses.nwb"
        with pynwb.NWBHDF5IO(str(path), "w") as out:
            out.write(nwb)
        content = path.read_bytes()
    return WrittenPoses(
        content,
        ("reprojection errors", "numbers of views", "when the session was: 1970-01-01 is written"),
    )
