"""poses3d.h5, our own file of 3D poses, which carries all.

Datasets: position `[frame, individual, keypoint, 3]`, error, views, confidence, source `[frame,
individual, keypoint]`, frames `[frame]`, keypoint_names `[keypoint]`; covariance `[frame,
individual, keypoint, 6]`, position_raw where that is not the position, individual_names
`[individual]`, keypoint_joints `[keypoint]` and edges `[edge, 2]` where they are known. Each says
its axes, its unit and its meaning in attributes; the file its rate (`fps`) where that is known.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from mocap_calib import mapped
from mocap_calib.io import hdf5
from mocap_calib.io.atomic import replace_file
from mocap_calib.io.document import Document
from mocap_calib.io.format import Format
from mocap_calib.io.poses import PoseFile, is_hdf5_that
from mocap_calib.io.world_fields import read_world, world_fields
from mocap_calib.results import POINT_SOURCES, Poses3D
from mocap_calib.types import check_shape

VERSION = 1
_FORMAT = "mocap-calib poses"
_POINTS = "frame, individual, keypoint"
_PLACES = f"{_POINTS}, coordinate (x, y, z)"
# dataset -> its axes, its unit ({} = that of the poses), and what it means
_DATASETS = {
    "position": (
        _PLACES,
        "{}",
        "3D position in the world that the cameras stand in, the best estimate; NaN = missing",
    ),
    "position_raw": (
        _PLACES,
        "{}",
        "the triangulated point, which the best estimate was made from; NaN = missing",
    ),
    "source": (
        _POINTS,
        "code",
        "what the position is made of: "
        + ", ".join(f"{code} = {source}" for code, source in enumerate(POINT_SOURCES)),
    ),
    "error": (
        _POINTS,
        "pixel",
        "RMS reprojection error of the triangulated point over the views used; NaN = missing or "
        "not known",
    ),
    "views": (_POINTS, "views", "number of views that the point was triangulated from"),
    "confidence": (
        _POINTS,
        "0 to 1",
        "mean confidence of the detections used; NaN = missing or not known",
    ),
    "covariance": (
        f"{_POINTS}, entry (xx, xy, xz, yy, yz, zz)",
        "{}^2",
        "covariance of the position, as far as it is due to the detectors' noise; NaN = missing",
    ),
    "frames": ("frame", "frame number", "number of each frame, as the keypoint files have it"),
    "keypoint_names": ("keypoint", "name", "name of each keypoint"),
    "keypoint_joints": (
        "keypoint",
        "name",
        "joint that each keypoint was said to be; empty = none",
    ),
    "individual_names": ("individual", "name", "name of each individual"),
    "edges": (
        "edge, end",
        "index of a keypoint",
        "pairs of keypoints that the skeleton joins, counted from 0: lines to draw",
    ),
}


def sniff(document: Document) -> bool:
    """Return whether the attribute `format` says that it is ours."""
    return is_hdf5_that(document, lambda file: file.attrs.get("format") == _FORMAT)


# --- reading


def read(document: Document) -> PoseFile:
    """Read the poses, the names of the individuals, the rate, the edges and the joints.

    Raises FormatError.
    """
    source = document.source
    with hdf5.opened_hdf5(document, f"{_FORMAT}, version {VERSION}") as file:
        format, version = file.attrs["format"], file.attrs["version"]
        if format != _FORMAT or version != VERSION:
            raise ValueError(f"format {format}, version {version}")

        def read_array(name: str) -> NDArray[Any]:
            return hdf5.array(file, name, source) if name in file else np.zeros(0)

        poses = Poses3D(
            keypoints=hdf5.names(file, "keypoint_names", source),
            frames=hdf5.integers(file, "frames", source),
            positions=hdf5.array(file, "position", source).astype(np.float64),
            error=hdf5.array(file, "error", source).astype(np.float64),
            views=hdf5.integers(file, "views", source),
            confidence=hdf5.array(file, "confidence", source).astype(np.float64),
            unit=str(file.attrs["unit"]),
            covariance=read_array("covariance").astype(np.float32),
            raw=read_array("position_raw").astype(np.float64),
            source=read_array("source").astype(np.int8),
            world=read_world(json.loads(file.attrs.get("world", "null"))),
        )
        no_edges = np.zeros((0, 2), dtype=np.int64)
        edges = hdf5.integers(file, "edges", source) if "edges" in file else no_edges
        check_shape("edges", edges, None, 2)
        return PoseFile(
            poses,
            float(file.attrs.get("fps", np.nan)),
            hdf5.names_if_there(file, "individual_names", source),
            edges=tuple(map(tuple, edges.tolist())),
            joints=hdf5.names_if_there(file, "keypoint_joints", source),
        )


def stored_provenance(path: Path) -> dict[str, Any]:
    """Return the provenance in a file of ours, nothing where it was edited."""
    with h5py.File(path, "r") as file:
        text = file.attrs.get("provenance", "{}")
    try:
        found = json.loads(text)
    except (ValueError, TypeError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


# --- writing


def write_poses_h5(path: Path, poses: PoseFile, provenance: Mapping[str, Any]) -> None:
    """Write poses of numbered individuals, whole or not at all, without a copy in memory."""
    with replace_file(path) as work, h5py.File(work, "w") as file:
        _fill(file, poses, provenance)


def write(poses: PoseFile, title: str) -> bytes:
    """Return a file with the names of the individuals; a title becomes its provenance."""
    with h5py.File("poses", "w", driver="core", backing_store=False) as file:
        _fill(file, poses, {"title": title} if title else {}, individuals=poses.individuals)
        file.flush()
        content: bytes = file.id.get_file_image()
    return content


def _fill(
    file: h5py.File,
    given: PoseFile,
    provenance: Mapping[str, Any],
    individuals: Sequence[str] = (),
) -> None:
    """Fill an HDF5 file. No times are written: they would change its bytes."""
    poses = given.poses
    arrays = {
        "position": poses.positions,
        "error": poses.error,
        "views": poses.views,
        "confidence": poses.confidence,
        "source": poses.source,
        "frames": poses.frames,
    }
    if poses.raw is not poses.positions:
        arrays["position_raw"] = poses.raw
    if _any_known(poses.covariance):
        arrays["covariance"] = poses.covariance
    if given.edges:
        arrays["edges"] = np.array(given.edges, dtype=np.int64)
    for name, array in arrays.items():
        hdf5.write_packed(file, name, array)
    hdf5.write_names(file, "keypoint_names", poses.keypoints)
    for name, words in (("keypoint_joints", given.joints), ("individual_names", individuals)):
        if words:
            hdf5.write_names(file, name, words)
    for name, dataset in file.items():
        axes, unit, meaning = _DATASETS[name]
        dataset.attrs["axes"] = axes
        dataset.attrs["unit"] = unit.format(poses.unit)
        dataset.attrs["meaning"] = meaning
    file.attrs["format"] = _FORMAT
    file.attrs["version"] = VERSION
    file.attrs["unit"] = poses.unit
    if poses.world.kind != "not known":
        file.attrs["world"] = json.dumps(world_fields(poses.world, poses.unit))
    file.attrs["dimensions"] = "frame, individual, keypoint, coordinate"
    if np.isfinite(given.rate):
        file.attrs["fps"] = file["frames"].attrs["fps"] = given.rate
    file.attrs["provenance"] = json.dumps(provenance, default=str)


def _any_known(array: NDArray[Any]) -> bool:
    """Return whether any number of an array `[frame, ...]` is finite."""
    return any(np.isfinite(array[block]).any() for block in mapped.frame_slices(len(array)))


POSES = Format(
    name="poses-h5",
    title="mocap-calib poses3d.h5",
    sniff=sniff,
    read=read,
    write=write,
    endings=(".h5",),
)
