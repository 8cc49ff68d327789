"""Arrays in files: our own h5, numpy's npz, and SLEAP-anipose's points3d.h5."""

import io
from collections.abc import Mapping
from typing import Any

import h5py
import numpy as np

from mocap_calib.io.file import malformed, one_line
from mocap_calib.io.hdf5 import array, integers, names
from mocap_calib.io.poses.common import (
    DAMAGE,
    PoseFile,
    WrittenPoses,
    attribute,
    bare_poses,
    fill_gaps,
    lost_quality,
)
from mocap_calib.io.results.poses_h5 import parse_poses_h5, poses_to_h5
from mocap_calib.io.sandbox import HDF5
from mocap_calib.io.units import known_unit
from mocap_calib.types import Poses3D, check_shape

_ARRAYS = ("positions", "error", "views", "confidence", "frames")
_OURS = "mocap-calib poses"


def looks(content: bytes, test: Any) -> bool:
    """Whether the content is HDF5 that passes the test; damaged files do not."""
    if not content.startswith(HDF5):
        return False
    try:
        with h5py.File(io.BytesIO(content), "r") as file:
            return bool(test(file))
    except DAMAGE:
        return False


# --- our own


def sniff_own(content: bytes) -> bool:
    """By the attribute `format`."""
    return looks(content, lambda file: attribute(file.attrs, "format") == _OURS)


def parse_own(content: bytes, source: str) -> PoseFile:
    """`poses3d.h5`. Raises FormatError."""
    poses = parse_poses_h5(content, source)
    try:
        with h5py.File(io.BytesIO(content), "r") as file:
            called = names(file, "individual_names", source) if "individual_names" in file else ()
            rate = float(file.attrs.get("fps", np.nan))
        return PoseFile(poses, rate, called)
    except DAMAGE as error:
        raise malformed(
            source, _OURS, f"an error ({one_line(error)})", "write the file again"
        ) from None


def write_own(file: PoseFile, title: str) -> WrittenPoses:
    """`poses3d.h5`; carries all. `title` is the provenance, as JSON."""
    return WrittenPoses(
        poses_to_h5(
            file.poses,
            _provenance(title),
            figures={"fps": file.rate},
            individuals=file.individuals,
        )
    )


def _provenance(title: str) -> Mapping[str, Any]:
    return {"title": title} if title else {}


# --- npz


def sniff_npz(content: bytes) -> bool:
    """A zip archive."""
    return content.startswith(b"PK\x03\x04")


def parse_npz(content: bytes, source: str) -> PoseFile:
    """The arrays of `write_npz`; no pickles are read. Raises FormatError."""
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as file:
            positions, error, confidence = (
                file[name].astype(np.float64) for name in ("positions", "error", "confidence")
            )
            views, frames = (
                file[name].astype(np.int64, casting="safe") for name in ("views", "frames")
            )
            keypoints, individuals = (
                tuple(map(str, file[name])) for name in ("keypoints", "individuals")
            )
            rate, unit = float(file["fps"]), str(file["unit"])
        check_shape("positions", positions, len(frames), len(individuals), len(keypoints), 3)
        for name, each in (("error", error), ("views", views), ("confidence", confidence)):
            check_shape(name, each, *positions.shape[:3])
        return PoseFile(
            Poses3D(
                keypoints, frames, positions, error, views, confidence, known_unit(unit, source)
            ),
            rate,
            individuals,
        )
    except DAMAGE as error:
        raise malformed(
            source,
            f"an .npz of poses ({', '.join(_ARRAYS)}, ...)",
            f"an error ({one_line(error)})",
            "write the file again",
        ) from None


def write_npz(file: PoseFile, title: str) -> WrittenPoses:
    """Everything, under the names of `Poses3D`; `numpy.load` reads it."""
    arrays: dict[str, Any] = {name: getattr(file.poses, name) for name in _ARRAYS}
    texts: dict[str, Any] = {
        "keypoints": np.array(file.poses.keypoints, dtype=str),
        "individuals": np.array(file.individuals, dtype=str),
    }
    content = io.BytesIO()
    np.savez_compressed(
        content,
        **arrays,
        **texts,
        fps=np.array(file.rate),
        unit=np.array(file.poses.unit),
        title=np.array(title),
    )
    return WrittenPoses(content.getvalue())


# --- SLEAP-anipose


def sniff_sleap_anipose(content: bytes) -> bool:
    """Tracks of 3D points; SLEAP's own 2D analysis, (track, 2, node, frame), has their occupancy, and perhaps three frames."""
    return looks(
        content,
        lambda file: (
            "tracks" in file
            and file["tracks"].ndim == 4
            and file["tracks"].shape[-1] == 3
            and "track_occupancy" not in file
        ),
    )


def parse_sleap_anipose(content: bytes, source: str) -> PoseFile:
    """`tracks` (frame, track, node, 3); its own files name no nodes and count frames from 0. Raises FormatError."""
    try:
        with h5py.File(io.BytesIO(content), "r") as file:
            positions = array(file, "tracks", source).astype(np.float64)
            check_shape("tracks", positions, None, None, None, 3)
            frames = (
                integers(file, "frames", source) if "frames" in file else np.arange(len(positions))
            )
            keypoints = names(file, "node_names", source) if "node_names" in file else ()
            individuals = names(file, "track_names", source) if "track_names" in file else ()
            unit, rate = attribute(file.attrs, "unit"), float(file.attrs.get("fps", np.nan))
        notes = (
            ()
            if keypoints
            else (
                f"the file does not name its {positions.shape[2]} nodes: they are called node_0, node_1, ...",
            )
        )
        keypoints = keypoints or tuple(f"node_{k}" for k in range(positions.shape[2]))
        check_shape("tracks", positions, len(frames), None, len(keypoints), 3)
        positions = np.where(np.isfinite(positions).all(-1, keepdims=True), positions, np.nan)
        return PoseFile(
            bare_poses(keypoints, frames, positions, known_unit(unit, source)),
            rate,
            individuals,
            notes,
        )
    except DAMAGE as error:
        raise malformed(
            source,
            "points3d.h5 of SLEAP-anipose",
            f"an error ({one_line(error)})",
            "write the file again",
        ) from None


def write_sleap_anipose(file: PoseFile, title: str) -> WrittenPoses:  # noqa: ARG001 - the writers' signature
    """`tracks` without gaps, and beside it what its readers do not look for: names, frame numbers, unit, rate."""
    frames, positions = fill_gaps(file.poses, "sleap-anipose")
    content = io.BytesIO()
    with h5py.File(content, "w") as out:
        tracks = out.create_dataset("tracks", data=positions, track_times=False)
        tracks.attrs["Description"] = "Shape: (n_frames, n_tracks, n_nodes, 3)."
        out.create_dataset("frames", data=frames, track_times=False)
        for name, values in (
            ("node_names", file.poses.keypoints),
            ("track_names", file.individuals),
        ):
            out.create_dataset(
                name,
                data=np.array(values, dtype=object),
                dtype=h5py.string_dtype(),
                track_times=False,
            )
        out.attrs["unit"], out.attrs["fps"] = file.poses.unit, file.rate
    return WrittenPoses(content.getvalue(), lost_quality(file))
